"""Saving: the suffix of a name chooses the format, from one table."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Protocol, overload

import xarray as xr
from numpy.typing import DTypeLike

from xcg.common.compat import stored_data
from xcg.writers import chains
from xcg.writers.encoding import Encoding
from xcg.writers.files import check_target
from xcg.writers.formats import NETCDF, ZARR
from xcg.writers.paraview import write_pvd
from xcg.writers.store import Output, write_all
from xcg.writers.store_layout import Format
from xcg.writers.vtkhdf import VTKHDF


class Writer(Protocol):
    """Writer of one format: ``write(ds, path, encoding, overwrite=...)``.

    `ds` is a scene, a result or chains, lazy or in memory; `encoding` says how numbers are stored,
    and ``encoding.reduced(values)`` gives them as they are asked for. The file should appear only
    when it is whole.
    """

    def __call__(
        self, ds: xr.Dataset, path: Path, encoding: Encoding, *, overwrite: bool
    ) -> object:
        """Write a Dataset."""


_WRITERS: dict[str, Writer | Format] = {
    ".nc": NETCDF,
    ".h5": NETCDF,
    ".zarr": ZARR,
    ".vtkhdf": VTKHDF,
    ".pvd": write_pvd,
}
_NAMES = {
    ".nc": ".nc (NetCDF)",
    ".h5": ".h5 (HDF5)",
    ".zarr": ".zarr (Zarr)",
    ".vtkhdf": ".vtkhdf (VTKHDF)",
    ".pvd": ".pvd (images for any ParaView)",
}


_TABLES = (
    "; a result becomes a table by f.to_dataframe().to_csv(path), and the grains of a scene by "
    "ds[['particle_id', 'mass']].to_dataframe().to_csv(path), as variables of one kind make a table"
)
# what to do instead, by suffixes that others write
_OTHER_SUFFIXES = {
    ".vtu": "; ParaView opens .vtkhdf and .pvd, and to_vtu writes fields onto a given mesh",
    ".vti": "; ParaView opens .vtkhdf and .pvd",
    ".vtk": "; ParaView opens .vtkhdf and .pvd",
    ".vtp": "; ParaView opens .vtkhdf and .pvd of fields, and grains by "
    "ds.cg.to_pyvista(shapes=False)['particles'].save('grains.vtp')",
    ".csv": _TABLES,
    ".txt": _TABLES,
    ".xlsx": _TABLES,
    ".hdf5": "; did you mean .h5?",
    ".png": "; pictures are drawn by plot and view",
}


def register_writer(suffix: str, write: Writer) -> None:
    """Register a writer of another format for `save`.

    Parameters
    ----------
    suffix : str
        End of the names that choose it, with its dot.
    write : callable
        ``write(ds, path, encoding, overwrite=...)``, see `Writer`. `save` has checked that the
        folder of `path` is there and that the name is free, unless it may be replaced.

    Returns
    -------
    None
        `save` takes the suffix in this process.

    Raises
    ------
    ValueError
        If the suffix has no dot, or is taken, or the writer is not a function.

    Examples
    --------
    A table of a profile as text:

    >>> import xcg
    >>> def write_csv(ds, path, encoding, *, overwrite):
    ...     ds.squeeze().reset_coords(drop=True).to_dataframe().to_csv(path)
    >>> xcg.register_writer(".csv", write_csv)
    """
    if not suffix.startswith(".") or len(suffix) < 2:
        raise ValueError(
            f"suffix={suffix!r}: expected the end of a name with its dot, such as '.csv'"
        )
    if suffix in _WRITERS and _WRITERS[suffix] != write:
        raise ValueError(f"suffix={suffix!r} is taken; choose another one")
    if not callable(write):
        raise ValueError(
            f"write={write!r}: expected a function write(ds, path, encoding, overwrite=...)"
        )
    _WRITERS[suffix] = write


@overload
def save(
    ds: xr.Dataset,
    path: str | os.PathLike[str],
    *,
    overwrite: bool = ...,
    dtype: DTypeLike | None = ...,
    digits: int | None = ...,
    compression: int | None = ...,
    resume: bool = ...,
    progress: bool | None = ...,
) -> Path: ...
@overload
def save(
    ds: xr.Dataset,
    path: list[str] | list[Path],
    *,
    overwrite: bool = ...,
    dtype: DTypeLike | None = ...,
    digits: int | None = ...,
    compression: int | None = ...,
    resume: bool = ...,
    progress: bool | None = ...,
) -> list[Path]: ...
def save(
    ds: xr.Dataset,
    path: str | os.PathLike[str] | list[str] | list[Path],
    *,
    overwrite: bool = False,
    dtype: DTypeLike | None = None,
    digits: int | None = None,
    compression: int | None = None,
    resume: bool = False,
    progress: bool | None = None,
) -> Path | list[Path]:
    """Write a scene or a result, as the name says: NetCDF, HDF5, Zarr or VTKHDF.

    A scene that is opened again with ``xr.open_dataset(path, chunks={})`` or ``xr.open_zarr(path)``
    is the same to the last bit, and `ds.cg` works on it. It opens at once, and is read several
    times as fast as the text it came from.

    A lazy Dataset is computed and written one chunk of time after the other by one task each, where
    xarray's own `to_netcdf` and `to_zarr` make one a variable. So it takes thousands of steps; and
    it may run on a cluster of processes that see the same folder. While one step is written, others
    are computed and compressed. A chunk on disk holds the steps of a chunk of the Dataset (one,
    where it is in memory), or more of them in Zarr where steps are short. Padding of steps with
    fewer rows takes hardly any room, as it compresses away.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene or a result, lazy or in memory.
    path : str or path, or list of them
        ``*.nc`` for NetCDF 4 (deflate), or ``*.h5`` for the same file, which is HDF5; ``*.zarr``
        for a Zarr folder (Zstandard), which is written and read faster, by several tasks at a time;
        ``*.vtkhdf`` for chains, and for fields on evenly spaced nodes, as one image with time steps
        and an array for each field and phase (``velocity``, ``velocity_phase_1``);
        ``*.pvd`` for fields as images, one file a step, which ParaView before 5.12 reads, too. It
        appears only when it is whole. A list of names (not of ``*.pvd``) writes all of them, and
        reads and computes each step once.
    overwrite : bool
        Replace existing files.
    dtype : {"float32", "float64"}, optional
        Type of floating-point numbers on disk; by default their own.
    digits : int, optional
        Significant digits to keep, 1 to 15: numbers are rounded to a relative error of at most
        ``0.5 * 10**-digits``, and compress well then. The attribute ``precision`` of each variable
        says so. By default all are kept.
    compression : int, optional
        Level of compression, 1 (fastest) to 9, or 0 for none. Only Zarr (Zstandard) has levels:
        NetCDF, HDF5 and VTKHDF are compressed by one fast encoder at any of them. By default 1 for
        scenes, and for fields of fewer digits or single precision; none for fields of full
        precision, which become a fifth smaller only.
    resume : bool
        Continue a file that an earlier call of this kind began, of the same scene, by the same
        call, and that was interrupted: steps that are complete are kept. Until the file is whole,
        it is in a hidden folder beside it, ``.<name>.begun``, which stays when the call fails or
        its process ends. For NetCDF, HDF5, Zarr and VTKHDF.
    progress : bool, optional
        Show the progress on the standard error: always or never. By default in a terminal or
        notebook where it takes longer than two seconds. Only lazy variables are counted.

    Returns
    -------
    pathlib.Path, or list of pathlib.Path
        The file or folder, or a list of them.

    Raises
    ------
    FileExistsError
        If it exists and `overwrite` is False, or another process is writing the same Zarr folder.
    ImportError
        If Zarr is not installed.
    SceneError
        If the file to resume was begun for another scene or by another call; the message says what
        differs. If a finite number is beyond the range of `dtype`; the message names the variable.
    TypeError
        If variables are quantities of pint.
    ValueError
        If the name ends otherwise, `resume` is asked for in another format, `dtype`, `digits` or
        `compression` is not one of the above, or the format does not take it: chains in VTKHDF take
        none of the three, ``*.pvd`` takes no `compression`.
    """
    paths = [Path(each) for each in path] if isinstance(path, list) else [Path(path)]
    writers = [_writer_of(each) for each in paths]
    _raise_for_units(ds)
    encoding = Encoding.of(ds, dtype, digits, compression)
    for each in paths:
        check_target(each, overwrite=overwrite)
    of_chains = VTKHDF in writers and "chain_id" in ds
    if write_pvd in writers and compression is not None:
        raise ValueError(
            f"{paths[writers.index(write_pvd)]}: VTK chooses the compression of images; leave out compression="
        )
    formats = [writer for writer in writers if isinstance(writer, Format)]
    if resume and (of_chains or len(formats) < len(writers)):
        raise ValueError(
            f"{paths[0]}: resume=True continues scenes and fields in .nc, .h5, .zarr and .vtkhdf only"
        )
    are_different = len(set(paths)) == len(paths) > 0
    are_together = are_different and len(formats) == len(paths) and not of_chains
    if isinstance(path, list) and not are_together:
        names = ", ".join(map(str, paths))
        raise ValueError(
            f"path=[{names}]: expected different names for scenes or fields that end with .nc, "
            ".h5, .zarr or .vtkhdf; save others by calls of their own"
        )
    if are_together:
        together = [dict(zip(paths, formats, strict=True))]
        if len(paths) > 1 and "time" not in ds.dims:
            # images have a time axis, and the other files should not
            ds = ds.compute()
            together = [{each: kind} for each, kind in zip(paths, formats, strict=True)]
        for files in together:
            write_all(
                Output(ds, files, encoding), overwrite=overwrite, resume=resume, progress=progress
            )
        return paths if isinstance(path, list) else paths[0]
    path = paths[0]
    writer = writers[0]
    if of_chains:
        options = {"dtype": dtype, "digits": digits, "compression": compression}
        passed = ", ".join(f"{name}=" for name, value in options.items() if value is not None)
        if passed:
            raise ValueError(
                f"{path}: chains in VTKHDF are written as they are; leave out {passed}, or save as .nc or .zarr"
            )
        chains.to_vtkhdf(ds, path, overwrite=overwrite)
    elif writer is write_pvd:
        write_pvd(ds, path, encoding, overwrite=overwrite, progress=progress)
    elif not isinstance(writer, Format):
        writer(ds, path, encoding, overwrite=overwrite)
    return path


def _writer_of(path: Path) -> Writer | Format:
    """Return the writer that the end of a name chooses."""
    if path.suffix not in _WRITERS:
        endings = ", ".join(_NAMES.get(end, end) for end in _WRITERS)
        hint = _OTHER_SUFFIXES.get(path.suffix, "")
        raise ValueError(f"{path}: expected a name that ends with {endings}{hint}")
    return _WRITERS[path.suffix]


def _raise_for_units(ds: xr.Dataset) -> None:
    """Raise TypeError if variables are quantities of pint."""
    with_units = [
        str(name)
        for name, v in ds.variables.items()
        if type(stored_data(v)).__module__.startswith("pint")
    ]
    if with_units:
        raise TypeError(
            f"{', '.join(with_units)}: expected plain numbers, not quantities of pint; "
            "ds.pint.dequantify(format='~C') keeps the units as attributes"
        )
