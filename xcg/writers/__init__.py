"""Writers of scenes, results and chains: NetCDF, Zarr, VTKHDF, ParaView's files, records, views in 3D."""
