"""Scenes and results as NetCDF 4, which is HDF5."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from xcg.writers.files import reserve
from xcg.writers.hdf5_store import Hdf5Store, StoredArray
from xcg.writers.store import Format, StoreLayout

_HEADER = 1 << 16  # bytes besides values, which the NetCDF library writes; it does not recover from a full disk


def _begin(layout: StoreLayout, path: Path, begun: bool) -> Hdf5Store:
    ds, level = layout.ds, layout.encoding.level
    if not begun:
        packed = {"zlib": True, "complevel": level, "shuffle": True} if level else {}
        how: dict[str, Any] = {name: {**packed, "chunksizes": layout.chunk_shape(name)} for name in layout.over}
        # Labels are characters of fixed length: netCDF 1.7 was seen to crash on texts of any length.
        how |= {str(name): {"dtype": "S1"} for name, data in ds.variables.items() if data.dtype.kind in "OUT"}
        reserve(path, _HEADER)
        # What this returns would write the zeros of the outline; it is let go, which closes the file.
        layout.outline().to_netcdf(path, engine="netcdf4", encoding=how, compute=False)
    arrays = [StoredArray(name, name, layout.chunk_shape(name)) for name in layout.over]
    return Hdf5Store.of(path, arrays, layout.encoding, layout.threads)


NETCDF = Format("NetCDF", _begin)
