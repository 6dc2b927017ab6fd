"""A function over the steps of a scene, with dask; what becomes of steps at fault; labels of results."""
