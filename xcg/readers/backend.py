"""``xr.open_dataset(path, engine="xcg")``: one file or one series, as xarray opens any other."""

from __future__ import annotations

import inspect
import os
from collections.abc import Iterable
from typing import Any

import xarray as xr
from xarray.backends import BackendEntrypoint

from xcg.common.messages import SceneError
from xcg.readers.engine import Engine
from xcg.readers.open import open_scene
from xcg.readers.paths import PathLike
from xcg.readers.recognise import is_recognised

_OF_XARRAY = ("particles", "engine", "chunks", "engine_options")  # called otherwise there


class SceneBackend(BackendEntrypoint):
    """Output of DEM codes as a scene.

    Arrays come without dask, or with it where ``chunks=`` is given to `xarray.open_dataset`: ``{}``
    for a step a chunk, ``{"time": 10}``, "auto". `xcg.open_scene` makes one task a chunk instead of
    one a variable, which is quicker for long series.
    """

    description = "Output of DEM codes (LAMMPS, LIGGGHTS, MFiX, MercuryDPM, ...) as scenes of xcg"
    open_dataset_parameters = (
        "filename_or_obj",
        "drop_variables",
        "reader",
        *(name for name in inspect.signature(open_scene).parameters if name not in _OF_XARRAY),
    )

    def open_dataset(  # type: ignore[override]  # further arguments are those of open_scene
        self,
        filename_or_obj: PathLike | Iterable[PathLike],
        *,
        drop_variables: str | Iterable[str] | None = None,
        reader: str | Engine | type[Engine] | None = None,
        **options: Any,
    ) -> xr.Dataset:
        """Open files of particles, and of contacts with ``contacts=``.

        Parameters
        ----------
        filename_or_obj : path, glob or list of them
            Files with particles.
        drop_variables : str or iterable of str, optional
            Variables to leave out.
        reader : str or Engine, optional
            ``engine`` of `xcg.open_scene`; guessed by default.
        **options
            All else that `xcg.open_scene` takes.
        """
        scene = open_scene(filename_or_obj, engine=reader, chunks=None, **options)
        for values in scene.variables.values():
            chunks = dict(values.sizes)
            if "time" in chunks:
                chunks["time"] = 1
            values.encoding["preferred_chunks"] = chunks
        return scene.drop_vars(drop_variables or [], errors="ignore")

    def open_datatree(  # type: ignore[override]
        self, filename_or_obj: PathLike, **options: Any
    ) -> xr.DataTree:
        """Raise SceneError: a scene is one Dataset."""
        raise SceneError("a scene is one Dataset: xarray.open_dataset(..., engine='xcg') opens it")

    open_groups_as_dict = open_datatree  # type: ignore[assignment]

    def guess_can_open(self, filename_or_obj: Any) -> bool:
        """Return whether an engine recognises a file by its content."""
        if not isinstance(filename_or_obj, (str, os.PathLike)) or not os.path.isfile(
            filename_or_obj
        ):
            return False
        return is_recognised(os.fspath(filename_or_obj))
