"""File formats, whatever code wrote them: text, compression, Parquet, NetCDF, VTK's XML."""
