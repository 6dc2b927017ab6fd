"""Engines, one for each DEM code or file layout: they map its columns to variables of a scene."""
