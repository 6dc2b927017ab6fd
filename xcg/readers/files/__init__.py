"""File formats, whatever code wrote them: text, compression, Parquet, VTK's XML."""
