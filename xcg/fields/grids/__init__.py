"""Places where fields are evaluated: meshes, points, rings of a cylinder; frames; walls."""
