"""Code that is not about scenes: messages, checks of arguments, labels of pictures, meshes of VTK."""
