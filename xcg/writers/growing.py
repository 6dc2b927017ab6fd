"""Files that grow by steps: what is in them is whole at any moment, whenever the process ends."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from xcg.writers.encoding import Encoding
from xcg.writers.files import whole_file
from xcg.writers.formats import ZARR
from xcg.writers.store import write_file

_CDF5: Any = "NETCDF3_64BIT_DATA"  # which xarray hands on, though its annotations do not list it


def _create_netcdf(path: Path, first: xr.Dataset, overwrite: bool) -> None:
    """Make a file in NetCDF's classic 64-bit format (CDF-5), with time as its record dimension.

    Steps are added to its end, and then their number is written into its header: a step that was
    not finished does not count. An HDF5 file could not be read after a process ended that was
    writing to it.
    """
    with whole_file(path, overwrite=overwrite) as part:
        first.to_netcdf(part, engine="netcdf4", format=_CDF5, unlimited_dims=["time"])


def _open_netcdf(path: Path) -> Any:
    import netCDF4

    file = netCDF4.Dataset(path, "r+")
    file.set_auto_maskandscale(False)
    return file


def _append_netcdf(file: Any, values: dict[str, np.ndarray], at: int) -> None:
    for name, value in values.items():
        file[name][at : at + 1] = value
    file.sync()


def _create_zarr(path: Path, first: xr.Dataset, overwrite: bool) -> None:
    """Make a Zarr folder with a file a variable and step.

    Steps count from the moment at which the consolidated metadata, one file that is replaced as a
    whole, says so.
    """
    write_file(first, path, Encoding(level=1), ZARR, overwrite=overwrite)


def _append_zarr(path: Path, values: dict[str, np.ndarray], at: int) -> None:
    import zarr

    group = zarr.open_group(path, mode="r+", use_consolidated=False)
    for name, value in values.items():
        array = group[name]
        array.resize((at + 1, *array.shape[1:]))
        array[at : at + 1] = value
    root = path / "zarr.json"
    metadata = json.loads(root.read_text())
    for name in values:
        metadata["consolidated_metadata"]["metadata"][name]["shape"][0] = at + 1
    part = root.with_suffix(".part")
    part.write_text(json.dumps(metadata))
    os.replace(part, root)


# how a file is made, opened for appending, and appended to
GROWING: dict[str, tuple[Callable, Callable, Callable]] = {
    ".nc": (_create_netcdf, _open_netcdf, _append_netcdf),
    ".zarr": (_create_zarr, nullcontext, _append_zarr),
}
