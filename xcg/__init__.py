"""Coarse-graining of granular matter: from DEM output to continuum fields."""
