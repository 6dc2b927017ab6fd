"""Layouts of Datasets as they are written, and the formats that lay them out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import dask
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.compiled._jit import THREADS
from xcg.scene.conform import storable
from xcg.writers.encoding import Encoding
from xcg.writers.files import renamed_file

# variables by name: arrays with time first, one or more that follow each other
Parts: TypeAlias = Mapping[str, Sequence[NDArray]]


class Store(Protocol):
    """A file or folder that is laid out, and takes the values of some steps; tasks call it, so it must pickle."""

    def __call__(self, parts: Parts, steps: slice) -> None:
        """Write the values of these steps."""

    def describe(self, attrs: Mapping[str, Any]) -> None:
        """Add attributes that are known in the end."""


@dataclass(frozen=True)
class StoreLayout:
    """A Dataset as it is written.

    Attributes
    ----------
    ds : xarray.Dataset
        What is written.
    over : list of str
        Numbers over time, which are written step by step.
    encoding : Encoding
        How they are stored.
    steps : int
        Steps in a chunk on disk.
    """

    ds: xr.Dataset
    over: list[str]
    encoding: Encoding
    steps: int

    @classmethod
    def of(
        cls,
        ds: xr.Dataset,
        encoding: Encoding,
        together: Callable[[StoreLayout], int] | None = None,
    ) -> StoreLayout:
        """Prepare a Dataset; `together` chooses the steps in a chunk on disk, by default those in a chunk of it."""
        ds = encoding.noted(storable(ds.drop_encoding()))
        # texts and dates are left to xarray, which writes them as something else; coordinates in
        # memory are small
        over = [
            str(name)
            for name, v in ds.variables.items()
            if v.dtype.kind in "biufc"
            and "time" in v.dims
            and v.size
            and (name in ds.data_vars or v.chunks is not None)
        ]
        ds = ds.assign({name: ds.variables[name].transpose("time", ...) for name in over})
        lazy_rest = {
            name: v for name, v in ds.variables.items() if v.chunks is not None and name not in over
        }
        # at once, as one task computes all fields of a step
        ds = ds.assign(dask.compute(lazy_rest)[0])
        for name, data in ds.data_vars.items():
            if name not in over and data.dtype.kind == "f":
                reduced = encoding.reduced(data.to_numpy(), str(name))
                ds = ds.assign({name: data.variable.copy(data=reduced)})
        ds = _aligned(ds, over)
        steps = max(
            (ds.variables[name].chunksizes.get("time", (1,))[0] for name in over), default=1
        )
        layout = cls(ds, over, encoding, max(1, min(steps, ds.sizes.get("time", 1))))
        if together is not None:
            layout = replace(layout, steps=together(layout))
        return layout

    @property
    def constant(self) -> list[str]:
        """Names of the other arrays of numbers, which have no time and are written at once."""
        return [
            str(name)
            for name, data in self.ds.data_vars.items()
            if name not in self.over and data.dtype.kind in "biufc" and data.ndim
        ]

    @property
    def lazy(self) -> list[str]:
        """Names of the variables that tasks compute."""
        return [name for name in self.over if self.ds.variables[name].chunks is not None]

    @property
    def threads(self) -> int:
        """Threads of a task: tasks share the processors; a single one has them all."""
        has_several_tasks = self.lazy and self.ds.sizes["time"] > self.steps
        return 1 if has_several_tasks else THREADS

    @property
    def step_numbers(self) -> NDArray:
        """Number of each step; its index in time without the coordinate ``step``."""
        if "step" in self.ds.coords:
            return self.ds["step"].to_numpy()
        return np.arange(self.ds.sizes.get("time", 1))

    def chunk_shape(self, name: str) -> tuple[int, ...]:
        """Shape of the chunks on disk of a variable over time, which is its first axis, whole along the others."""
        return (self.steps, *self.ds[name].shape[1:])

    def outline(self) -> xr.Dataset:
        """Return the same Dataset with placeholders, which nothing computes, for the arrays that tasks write."""
        import dask.array as da  # slow to import

        placeholders: dict[str, xr.Variable] = {}
        for name in self.over:
            data = self.ds.variables[name]
            # with a name dask need not hash what it is made of
            zeros = da.zeros(
                data.shape,
                dtype=self.encoding.type_of(data.dtype),
                chunks=-1,
                name=f"outline-{name}",
            )
            placeholders[name] = data.copy(data=zeros)
        return self.ds.assign(placeholders)


def _aligned(ds: xr.Dataset, over: Sequence[str]) -> xr.Dataset:
    """Rechunk all lazy variables, whole but along time, where their chunks are the same and even.

    So no two tasks write to one chunk on disk, and one task computes a step of all of them.
    """
    lazy = {name: ds.variables[name] for name in over if ds.variables[name].chunks is not None}
    steps = math.lcm(*(v.chunksizes["time"][0] for v in lazy.values()))
    return ds.assign(
        {name: v.chunk({**dict.fromkeys(v.dims, -1), "time": steps}) for name, v in lazy.items()}
    )


@dataclass(frozen=True)
class Format:
    """Properties of a format.

    Attributes
    ----------
    name : str
        Its name.
    begin : callable
        ``begin(layout, path, begun)`` lays out a file, unless it is `begun`, and returns its
        `Store`.
    check : callable
        Refuses a Dataset that the format cannot hold, and brings it into its form.
    together : callable, optional
        See `StoreLayout.of`.
    whole : callable
        Context that gives a complete file its name, as `renamed_file`.
    """

    name: str
    begin: Callable[[StoreLayout, Path, bool], Store]
    check: Callable[[xr.Dataset], xr.Dataset] = lambda ds: ds
    together: Callable[[StoreLayout], int] | None = None
    whole: Callable[..., AbstractContextManager[Path]] = renamed_file


def joined(parts: Sequence[NDArray]) -> NDArray:
    """Join arrays that follow each other; a single one is not copied."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts)
