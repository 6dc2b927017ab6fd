"""Readers: one module for each DEM code, and the series that they make one lazy scene of."""
