"""One engine for each DEM code or layout of files: what its columns are in a scene."""
