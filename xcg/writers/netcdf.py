"""Scenes and results as NetCDF 4, one chunk of time after the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.compiled import THREADS
from xcg.compiled.threads import for_each
from xcg.writers.chunks import joined, lock_for, over_time
from xcg.writers.encoding import Encoding, deflated
from xcg.writers.files import hdf5_file, whole_file
from xcg.writers.layout import chunk_shape, outline, prepared, steps_in_chunk, write_all


@dataclass(frozen=True)
class _Hdf5:
    """A NetCDF 4 file, which is an HDF5 file: opened and closed by every task, one at a time.

    The HDF5 library lets in one thread at a time. So chunks are rounded and compressed before, and it is given their
    bytes, which it would copy otherwise.
    """

    path: Path
    lock: Any
    encoding: Encoding
    steps: int  # in a chunk on disk
    threads: int

    def __call__(self, parts: Mapping[str, Sequence[NDArray]], steps: slice) -> None:
        values = {name: joined(part) for name, part in parts.items()}
        ready = dict(zip(values, for_each(list(values.values()), self._packed, self.threads), strict=True))
        with self.lock, hdf5_file(self.path, "r+") as file:
            for name, chunks in ready.items():
                if isinstance(chunks, np.ndarray):
                    file[name][steps] = chunks
                    continue
                for k, chunk in enumerate(chunks):
                    place = (steps.start + k * self.steps, *(0,) * (values[name].ndim - 1))
                    file[name].id.write_direct_chunk(place, chunk)

    def _packed(self, values: NDArray) -> NDArray | list[Any]:
        """Bytes of whole chunks of numbers, the last of which may reach beyond the end; anything else as it is."""
        values = self.encoding.reduced(values)
        if values.dtype.kind not in "fiu" or not values.dtype.isnative:
            return values
        packed = []
        for first in range(0, len(values), self.steps):
            part = values[first : first + self.steps]
            if len(part) < self.steps:
                part = np.concatenate([part, np.zeros((self.steps - len(part), *part.shape[1:]), part.dtype)])
            packed.append(deflated(part, self.encoding.level) if self.encoding.level else np.ascontiguousarray(part))
        return packed


def write_netcdf(ds: xr.Dataset, path: Path, encoding: Encoding, *, overwrite: bool, room: int = 0) -> None:
    """Write NetCDF under any name; `room` as in `xcg.writers.files.whole_file`."""
    ds, over = prepared(ds, encoding)
    steps = max(1, min(steps_in_chunk(ds, over), ds.sizes.get("time", 1)))
    packed = {"zlib": True, "complevel": encoding.level, "shuffle": True} if encoding.level else {}
    layout: dict[str, Any] = {name: {**packed, "chunksizes": chunk_shape(ds[name], steps)} for name in over}
    # Labels are characters of fixed length: netCDF 1.7 was seen to crash on texts of any length.
    layout |= {str(name): {"dtype": "S1"} for name, data in ds.variables.items() if data.dtype.kind in "OUT"}
    # tasks share the processors; a single one has them all
    threads = THREADS if ds.sizes.get("time", 0) <= steps or not over_time(ds) else 1
    with whole_file(path, overwrite=overwrite, room=room) as part:
        # What this returns would write the zeros of the outline; it is let go, which closes the file.
        outline(ds, over, encoding).to_netcdf(part, engine="netcdf4", encoding=layout, compute=False)
        write_all(ds, over, _Hdf5(part, lock_for(part), encoding, steps, threads), steps)
