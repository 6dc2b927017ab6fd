"""Where fields are evaluated: meshes, points, rings of a cylinder; the frames that they stand in; walls."""
