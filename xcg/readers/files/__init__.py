"""What files hold, whatever code wrote them: lines and columns of texts, compression, Parquet, NetCDF, VTK's XML."""
