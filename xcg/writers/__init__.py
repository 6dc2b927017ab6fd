"""Writers of results in formats that xarray does not write itself."""
