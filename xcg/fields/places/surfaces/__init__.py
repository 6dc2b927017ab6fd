"""Walls as geometry: planes, cylinders and triangulated surfaces."""
