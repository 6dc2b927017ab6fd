"""VTKHDF: results as one temporal image, for ParaView (5.12 and later) and ``vtkHDFReader``.

Scalars, vectors (``component``) and tensors (``component``, ``direction``) become point data with
1, 3 and 9 components, the latter row by row: xx, xy, xz, yx, ... A field with phases becomes one
array a phase: ``velocity`` for the bulk and ``velocity_phase_1`` for phase "1". Results with fewer
axes become images with one node along the others, at the coordinate given by ``at`` or at 0.
Integers stay integers. Attributes of a field (units, long_name) are on its array, attributes of the
Dataset on the group ``/xcg``.

The file holds what the reader was found to read back, not all that its description allows: axes
with one node do not appear in the shape of arrays, and a file with a single step has no time axis
either. Of a single step VTK does not report the time; it is in ``Steps/Values`` all the same.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.scene.conform import in_order, labels_along
from xcg.scene.frame import with_time
from xcg.scene.schema import COMPONENTS
from xcg.scene.times import check_times
from xcg.writers.formats import Hdf5Store, StoredArray, hdf5_file
from xcg.writers.store_layout import Format, StoreLayout

if TYPE_CHECKING:
    import h5py

_ON_DISK = ("time", "z", "y", "x", "component", "direction")  # x runs fastest among nodes
_BLOCK = 1 << 22  # bytes of a chunk on disk, of one step


# --- what is written -------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Image:
    """Nodes and times: number of nodes, origin and spacing along x, y, z."""

    nodes: tuple[int, ...]
    origin: tuple[float, ...]
    spacing: tuple[float, ...]
    times: NDArray | None

    @classmethod
    def of(cls, fields: xr.Dataset) -> Image:
        """Find nodes and times of fields."""
        nodes, origin, spacing = zip(*(_axis(fields, axis) for axis in COMPONENTS), strict=True)
        return cls(nodes, origin, spacing, times_of(fields))

    @property
    def steps(self) -> int:
        """Number of steps."""
        return 1 if self.times is None else len(self.times)

    @property
    def temporal(self) -> bool:
        """Return whether there are several steps."""
        return self.steps > 1

    def shape(self, components: int) -> tuple[int, ...]:
        """Shape on disk: the reader wants no axes of length one, but at least one axis."""
        lengths = [n for n in (self.steps, *reversed(self.nodes)) if n > 1] or [1]
        if components > 1:
            lengths.append(components)
        return tuple(lengths)


@dataclass(frozen=True)
class _Array:
    """Array of point data: a variable, or one phase of it."""

    name: str
    variable: str
    phase: int | None
    components: int
    dtype: np.dtype[Any]

    def part(self, data: xr.Variable) -> xr.Variable:
        """Return the phase of a variable."""
        if self.phase is None:
            return data
        return data.isel(phase=self.phase)

    def values(self, data: xr.Variable, image: Image) -> NDArray:
        """Values of some steps in the order on disk; time first, unless the image has one step only."""
        data = self.part(data)
        steps = data.sizes.get("time", 1)
        sizes: dict[Hashable, int] = dict(zip(COMPONENTS, image.nodes, strict=True))
        sizes |= {"time": steps, **data.sizes}
        present = [dim for dim in _ON_DISK if dim in sizes]
        values = data.set_dims(sizes).transpose(*present).to_numpy()
        shape = image.shape(self.components)
        if image.temporal:
            shape = (steps, *shape[1:])
        return values.reshape(shape).astype(self.dtype)


def arrays_of(fields: xr.Dataset) -> list[_Array]:
    """List the arrays of all variables and phases."""
    arrays = []
    for name, data in fields.data_vars.items():
        components = 3 ** len({"component", "direction"} & set(data.dims))
        if data.dtype.kind not in "fiub":
            raise ValueError(
                f"'{name}' holds {data.dtype}, expected numbers; leave it out with fields.drop_vars('{name}')"
            )
        # VTK knows floating point of 4 and 8 bytes, and no truth values
        of_kind = {"f": np.dtype(f"f{min(max(data.dtype.itemsize, 4), 8)}"), "b": np.dtype("u1")}
        dtype = of_kind.get(data.dtype.kind, data.dtype.newbyteorder("="))
        if "phase" not in data.dims:
            arrays.append(_Array(str(name), str(name), None, components, dtype))
            continue
        for index, phase in enumerate(map(str, fields["phase"].to_numpy())):
            label = str(name)
            if phase != "bulk":
                label += f"_phase_{phase.replace('/', '_')}"
            arrays.append(_Array(label, str(name), index, components, dtype))
    names = [array.name for array in arrays]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"several arrays would be named {twice}; rename the variables or phases")
    return arrays


# --- checks ----------------------------------------------------------------------------------------------


def checked(fields: xr.Dataset) -> xr.Dataset:
    """Raise an error unless a Dataset is a result; sort components into the order x, y, z."""
    if not fields.data_vars:
        raise ValueError("fields holds no variables; expected a result of coarse_grain")
    if {"particle", "contact"} & set(fields.dims):
        raise ValueError(
            "particles and contacts are no dimensions of an image: save scenes, and results by grain, as NetCDF or Zarr"
        )
    fields = with_time(fields)
    allowed = {*_ON_DISK, "phase"}
    for name, data in fields.data_vars.items():
        unknown = sorted(map(str, set(data.dims) - allowed))
        if unknown:
            raise ValueError(
                f"'{name}' has the dimensions {unknown}, expected some of {sorted(allowed)}; select or average "
                f"over them, or leave it out with fields.drop_vars('{name}'). Fields at points are no image: save them "
                "as NetCDF or Zarr, or on their mesh with to_vtu"
            )
    return with_components(fields)


def with_components(fields: xr.Dataset) -> xr.Dataset:
    """Sort components into the order x, y, z; raise for vectors and tensors that lack some."""
    for dim in ("component", "direction"):
        if dim not in fields.sizes:
            continue
        ordered = in_order(fields, dim, COMPONENTS)
        if ordered is None:
            users = sorted(str(name) for name, data in fields.data_vars.items() if dim in data.dims)
            labels: object = f"{fields.sizes[dim]} entries"
            if dim in fields.coords:
                labels = list(map(str, labels_along(fields, dim)))
            raise ValueError(
                f"'{dim}' of {users} holds {labels}, expected x, y and z; keep all three, or write one of "
                f"them with fields.sel({dim}='x')"
            )
        fields = ordered
    return fields


def _numbers(fields: xr.Dataset, name: str) -> NDArray:
    """Return a coordinate as finite numbers."""
    if name not in fields.coords:
        raise ValueError(
            f"dimension '{name}' has no coordinate; assign one with fields.assign_coords({name}=...)"
        )
    values = fields[name].to_numpy()
    wrong = values
    if values.dtype.kind in "fiu":
        wrong = values[~np.isfinite(values)]
    if wrong.size:
        raise ValueError(f"coordinate '{name}' holds {wrong.flat[0]!r}; expected finite numbers")
    return values.astype("float64")


def _axis(fields: xr.Dataset, axis: str) -> tuple[int, float, float]:
    """Nodes, origin and spacing along one axis."""
    nodes = np.zeros(1)
    if axis in fields.sizes or (axis in fields.coords and fields[axis].ndim == 0):
        nodes = _numbers(fields, axis).reshape(-1)
    if not nodes.size:
        raise ValueError(f"dimension '{axis}' has no nodes; expected at least one")
    if nodes.size == 1:
        return 1, float(nodes[0]), 1.0
    spacing = (nodes[-1] - nodes[0]) / (nodes.size - 1)
    even = nodes[0] + spacing * np.arange(nodes.size)
    if not (spacing > 0 and np.abs(nodes - even).max() <= 1e-6 * spacing):
        worst = int(np.argmax(np.abs(nodes - even)))
        raise ValueError(
            f"coordinate '{axis}' is not evenly spaced and rising: node {worst} is at {nodes[worst]}, expected "
            f"{even[worst]}; an image needs even spacing: use fields.sortby('{axis}') or "
            f"fields.interp({axis}=np.linspace(...)), or write NetCDF"
        )
    return nodes.size, float(nodes[0]), float(spacing)


def times_of(fields: xr.Dataset) -> NDArray | None:
    """Return the times of the steps, None for a result that knows no time."""
    if "time" not in fields.sizes and "time" not in fields.coords:
        return None
    times = _numbers(fields, "time").reshape(-1)
    if not times.size:
        raise ValueError(
            "fields has no time steps (the size of 'time' is 0); expected at least one"
        )
    check_times(times, "ParaView", "order the steps with sortby('time').drop_duplicates('time')")
    return times


# --- the file --------------------------------------------------------------------------------------------


def _begin(layout: StoreLayout, path: Path, begun: bool) -> Hdf5Store:
    image = Image.of(layout.ds)
    arrays = arrays_of(layout.ds)
    steps = 0
    if image.temporal:
        steps = layout.steps
    chunks = [_blocks(image.shape(a.components), a.dtype.itemsize, steps) for a in arrays]
    if not begun:
        with hdf5_file(path, "w") as file:
            _lay_out(file, layout, image, arrays, chunks)
    over: list[StoredArray] = []
    for array, chunk in zip(arrays, chunks, strict=True):
        if array.variable in layout.over:
            on_disk = partial(_on_disk, array, layout.ds[array.variable].dims, image)
            name = f"VTKHDF/PointData/{array.name}"
            dtype = layout.encoding.type_of(array.dtype)
            over.append(StoredArray(name, array.variable, chunk, dtype, on_disk))
    return Hdf5Store(path, over, layout, "xcg")


def _on_disk(array: _Array, dims: tuple[Hashable, ...], image: Image, values: NDArray) -> NDArray:
    return array.values(xr.Variable(dims, values), image)


def _lay_out(
    file: h5py.File,
    layout: StoreLayout,
    image: Image,
    arrays: list[_Array],
    chunks: list[tuple[int, ...]],
) -> None:
    """Write all but the values over time."""
    fields = layout.ds
    encoding = layout.encoding
    root = file.create_group("VTKHDF")
    root.attrs["Version"] = (2, 0)
    root.attrs["Type"] = np.bytes_("ImageData")  # the reader takes ASCII of fixed length only
    root.attrs["WholeExtent"] = np.array([(0, n - 1) for n in image.nodes]).ravel()
    root.attrs["Origin"] = image.origin
    root.attrs["Spacing"] = image.spacing
    root.attrs["Direction"] = np.eye(3).ravel()
    data = root.create_group("PointData")
    packed: dict[str, Any] = {}
    if encoding.level:
        packed = {"compression": "gzip", "compression_opts": encoding.level, "shuffle": True}
    for array, chunk in zip(arrays, chunks, strict=True):
        shape = image.shape(array.components)
        dtype = encoding.type_of(array.dtype)
        target = data.create_dataset(array.name, shape, dtype, chunks=chunk, **packed)
        _describe(target, fields[array.variable].attrs)
        if array.variable not in layout.over:
            values = array.values(fields[array.variable].variable, image)
            target[...] = encoding.reduced(values, array.variable)
    if image.times is not None:
        steps = root.create_group("Steps")
        steps.attrs["NSteps"] = len(image.times)
        steps["Values"] = image.times
        offsets = steps.create_group("PointDataOffsets")
        for array in arrays:
            offsets[array.name] = np.arange(len(image.times))
        # missed by the reader even where there are no cell data
        steps.create_group("CellDataOffsets")
    _describe(file.create_group("xcg"), fields.attrs)


def _blocks(shape: tuple[int, ...], itemsize: int, steps: int) -> tuple[int, ...]:
    """Shape of the chunks on disk: some steps (0 without a time axis), cut into even slabs where these are large.

    HDF5 stores the last slab whole, so that uneven ones would take memory beyond the end.
    """
    block = list(shape)
    first = 0
    if steps:
        block[0] = min(steps, shape[0])
        first = 1
    if first < len(block):
        slab = itemsize * int(np.prod(block[:first])) * int(np.prod(block[first + 1 :]))
        slabs = math.ceil(shape[first] / max(1, _BLOCK // slab))
        block[first] = math.ceil(shape[first] / max(1, slabs))
    return tuple(block)


def _describe(target: Any, attrs: Mapping[Any, Any]) -> None:
    """Copy attributes, as text where HDF5 has no type for them."""
    import h5py

    for key, value in attrs.items():
        array = np.asarray(value)
        if array.dtype.kind == "U":
            target.attrs.create(str(key), array.astype(object), dtype=h5py.string_dtype())
        elif array.dtype.kind in "fiub":
            target.attrs[str(key)] = value
        else:
            target.attrs[str(key)] = str(value)


VTKHDF = Format("VTKHDF", _begin, check=checked)
