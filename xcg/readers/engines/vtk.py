"""VTK PolyData and unstructured grids of any code: steps in lists of files, globs and .pvd collections."""

from __future__ import annotations

import filecmp
import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np
import xarray as xr

from xcg.common.messages import SceneError, warn_user
from xcg.common.vtk_mesh import places_of, read_mesh
from xcg.readers.columns import unify_sizes, warn_of_resembling
from xcg.readers.engine import Engine, ReadOptions, StepRef
from xcg.readers.files import vtp
from xcg.readers.files.text import ENDINGS, open_binary, plain_name
from xcg.readers.names import (
    PARTICLE_ARRAYS,
    PARTICLE_SLOTS,
    canonical,
    canonical_columns,
    components,
)
from xcg.readers.paths import number_steps, remembered
from xcg.scene.schema import COMPONENTS, Frame, variable
from xcg.steps import faults as errors

LINES = "lines"  # kind of a step whose contacts are lines
_VECTORS = ("velocity", "angular_velocity")
_COMPONENTS = [component for vector in _VECTORS for component in components(vector)]


def is_vtk(path: str, suffixes: Sequence[str], *kinds: bytes) -> bool:
    """Return whether a VTK file has one of these suffixes, before that of a compression, and one of these kinds."""
    if Path(plain_name(path)).suffix not in suffixes:
        return False
    with open_binary(path) as file:
        head = file.read(1024)
    return b"<VTKFile" in head and any(kind in head for kind in kinds)


def list_steps(paths: Sequence[str], options: ReadOptions, *, lines: bool = False) -> list[StepRef]:
    """List the steps of files and collections without copies; of lines where files hold some and they are wanted."""
    there = _existing(paths, options)
    found = remembered([path for path, _ in there], f"vtp {lines=}", partial(_header, lines=lines))
    timed = [
        [replace(ref, time=_time(ref.time, time)) for ref in steps]
        for (_, time), steps in zip(there, found, strict=True)
    ]
    return _once(number_steps([path for path, _ in there], timed))


def _header(path: str, *, lines: bool) -> list[StepRef]:
    """Return the step of a file, from its header."""
    header = vtp.read_header(path, lines=lines)
    kind = LINES if header.of_lines else ""
    return [
        StepRef(
            path,
            rows=header.rows,
            step=-1,
            time=header.time,
            columns=header.names,
            size=header.size,
            kind=kind,
        )
    ]


def _existing(paths: Sequence[str], options: ReadOptions) -> list[tuple[str, float | None]]:
    """Files with their listed times: collections expanded, missing files refused or skipped."""
    missing = options.extra.get("missing", "raise")
    if missing not in ("raise", "skip"):
        raise SceneError(f"missing={missing!r}: expected 'raise' or 'skip'")
    listed: list[tuple[str, float | None]] = []
    for path in map(str, paths):
        try:
            is_list = plain_name(path).endswith(".pvd") and Path(path).exists()
            listed += vtp.read_collection(path) if is_list else [(path, None)]
        except errors.FAULTS as error:
            if not errors.record_fault(path, error):
                raise
    # a list may name files that were compressed later
    packed = {path: [path, *(path + ending for ending in ENDINGS)] for path, _ in listed}
    listed = [(next(filter(os.path.isfile, packed[path]), path), time) for path, time in listed]
    there = [entry for entry in listed if os.path.isfile(entry[0])]  # a pipe would be waited for
    # MFiX lists its last frame twice: a copy that is gone is not missed.
    times = {time for _, time in there if time is not None}
    gone = [path for path, time in listed if not os.path.isfile(path) and time not in times]
    if gone:
        shown = f"{len(gone)} of {len(listed)} files do not exist: {', '.join(gone)}"
        if missing == "raise" or not there:
            way_out = "pass missing='skip' to go on with the others" if there else "check the path"
            raise SceneError(f"{shown}; restore them, or {way_out}")
        if not errors.record_fault(str(paths[0]), SceneError(f"{shown}; they are skipped")):
            warn_user(f"{shown}; they are skipped")
    return there


def _time(own: float | None, listed: float | None) -> float | None:
    """Time of a step: the file's own, unless the collection says otherwise (it prints seven digits)."""
    if own is None or listed is None:
        return own if listed is None else listed
    return own if np.isclose(own, listed, rtol=1e-6, atol=0) else listed


def _once(refs: Sequence[StepRef]) -> list[StepRef]:
    """Drop files with the bytes of an earlier one of the same time: MFiX writes its last frame twice."""
    firsts: dict[object, StepRef] = {}
    kept = []
    for ref in refs:
        first = firsts.setdefault(ref.path if ref.time is None else ref.time, ref)
        if _region(first) != _region(ref):
            raise SceneError(
                f"{first.path} and {ref.path} are of the same time, {ref.time} s, but of different regions; "
                "open one region at a time"
            )
        if (
            first is ref
            or first.size != ref.size
            or not filecmp.cmp(first.path, ref.path, shallow=False)
        ):
            kept.append(ref)
    return kept


def _region(ref: StepRef) -> str:
    return re.sub(r"\d+(?=\D*$)", "", Path(plain_name(ref.path)).stem)


def open_step(ref: StepRef) -> vtp.Header:
    """Read the header of a step again, which has to be as it was."""
    header = vtp.read_header(ref.path, lines=ref.kind == LINES)
    if (header.rows, header.names) != (ref.rows, ref.columns) or (
        ref.size and header.size != ref.size
    ):
        raise SceneError(
            f"{ref.path}: the file changed after the scene was opened; open the scene again"
        )
    return header


def read_arrays(ref: StepRef, wanted: Mapping[str, str]) -> Frame:
    """Read the arrays of one step by the names of the scene."""
    arrays = vtp.read_arrays(open_step(ref), [*wanted.values()])
    return {name: arrays[array] for name, array in wanted.items()}


class Vtk(Engine):
    """Points and lines of any code, one step a file; arrays by ``names=``.

    Attributes
    ----------
    CONTACT_NAMES : mapping
        Arrays that are taken for variables of contacts without ``names=``; the first of two for one
        variable counts. Those of particles are in `xcg.readers.names`.
    LINES : bool
        Whether contacts are lines where a file holds any; else they are points.
    ADVICE : str
        What to do about contacts without ids or forces, a sentence.
    """

    CONTACT_NAMES: ClassVar[Mapping[str, str]] = {}
    LINES: ClassVar[bool] = True
    ROWS_ARE_IDS: ClassVar[bool] = False
    ADVICE: ClassVar[str] = "Say which arrays they are, as in names={'...': 'contact_i'}"

    def recognises(self, path: str) -> bool:
        """Return whether this is an unstructured grid; PolyData is read as MFiX's unless an engine is named."""
        return is_vtk(path, (".vtu",), b"UnstructuredGrid")

    def index_particles(self, paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
        """List the steps of particles from the headers of files, or of the ``.pvd`` collections that name them.

        Parameters
        ----------
        paths : sequence of str
            Files of one region, or ``.pvd`` collections, whose times are taken where the files say none.
        options : ReadOptions
            ``extra["missing"]`` is "raise" (default) or "skip": what to do about files that do not exist.

        Raises
        ------
        SceneError
            If files are missing, damaged, or of several regions.

        Warns
        -----
        SceneWarning
            For files that are missing and skipped.
        """
        refs = list_steps(paths, options)
        for ref in refs:
            self.targets(ref, options)
        if refs:
            ignored = self.ignored_columns(refs[0], options)
            unread = [array for array in ignored if array not in options.names]
            warn_of_resembling(refs[0], unread, self.targets(refs[0], options), contacts=False)
        return refs

    def index_contacts(self, paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
        """List the steps of contacts from the headers of files; see `index_particles`.

        Raises
        ------
        SceneError
            Also if ids or forces are not among the arrays.
        """
        refs = list_steps(paths, options, lines=self.LINES)
        for ref in refs:
            there = self.contact_variables(ref, options)
            lacking = [
                name for name in ("contact_i", "contact_j", "contact_force") if name not in there
            ]
            if lacking:
                raise SceneError(
                    f"{ref.path}: contacts lack {lacking}; found {list(ref.columns)}. {self.ADVICE}"
                )
        return refs

    def targets(
        self, ref: StepRef, options: ReadOptions, *, contacts: bool = False
    ) -> dict[str, str]:
        """Return the array of each variable, or component, of particles or contacts.

        Raises
        ------
        SceneError
            If `names` maps an array that is not there, or two arrays to one variable.
        """
        dim = "contact" if contacts else "particle"
        mapped = {
            array: name
            for array, name in options.names.items()
            if name is not None and variable(name).dims[0] == dim
        }
        absent = [array for array in mapped if array not in ref.columns]
        if absent:
            raise SceneError(
                f"{ref.path}: names= maps {absent}, which are not in this file; "
                f"it holds {list(ref.columns)}"
            )
        twice = [name for name, count in Counter(mapped.values()).items() if count > 1]
        if twice:
            raise SceneError(
                f"names= maps several arrays to {sorted(twice)}; expected one array a name"
            )
        targets = {name: array for array, name in mapped.items()}
        points = ref.columns[0]
        if ref.kind != LINES and points not in options.names:
            targets.setdefault("contact_point" if contacts else "position", points)
        named = canonical_columns(array for array in ref.columns if array not in options.names)
        known = self.CONTACT_NAMES if contacts else PARTICLE_ARRAYS
        for name, variable_name in known.items():
            arrays = named.get(canonical(name))
            if arrays:
                targets.setdefault(variable_name, arrays[0])
        if not contacts:
            for component in _COMPONENTS:
                arrays = [
                    array for name in PARTICLE_SLOTS[component] for array in named.get(name, ())
                ]
                if arrays and component[:-2] not in targets:
                    targets.setdefault(component, arrays[0])
        return {
            name: array for name, array in targets.items() if not name.startswith(options.unwanted)
        }

    def contact_variables(self, ref: StepRef, options: ReadOptions) -> list[str]:
        """List the variables that `read_contacts` returns, from the header alone."""
        return list(self.targets(ref, options, contacts=True))

    def ignored_columns(
        self, ref: StepRef, options: ReadOptions, *, contacts: bool = False
    ) -> list[str]:
        """Arrays of a step that are not read."""
        found = self.targets(ref, options, contacts=contacts)
        return [array for array in ref.columns if array not in found.values()]

    def read_particles(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Read the particles of one step; radii become diameters, and components vectors."""
        frame = read_arrays(ref, self.targets(ref, options))
        for vector in _VECTORS:
            parts = {name: frame.pop(name) for name in components(vector) if name in frame}
            if parts:
                if vector not in frame and len(parts) < len(COMPONENTS):
                    raise SceneError(
                        f"{ref.path}: {', '.join(parts)} of the {vector.replace('_', ' ')}, and not all "
                        "three components; drop them by names={'...': None}"
                    )
                frame.setdefault(vector, np.stack([*parts.values()], axis=1))
        unify_sizes(frame, ref)
        return frame

    def read_contacts(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Read the contacts of one step as they stand: points are contact points; on lines they follow from radii."""
        return read_arrays(ref, self.targets(ref, options, contacts=True))


def mesh_points(path: str | os.PathLike[str], *, centers: bool = False) -> dict[str, xr.DataArray]:
    """Points of a mesh or surface, or the centres of its cells, as `coarse_grain` takes them: ``at=mesh_points(...)``.

    `to_vtu` writes the fields at them back onto the mesh.

    Parameters
    ----------
    path : str or path
        A file that VTK reads: ``.vtu``, ``.vtp``, ``.vts``, ``.vtr``, ``.vti``, ``.vtk``, ``.stl``, ``.obj``, ``.ply``.
    centers : bool
        Take the centres of cells (VTK's parametric centres, as ParaView's filter "Cell Centers"), where codes of finite
        volumes keep their fields; else the points.

    Returns
    -------
    dict
        Coordinates ``x``, ``y`` and ``z`` (m) with the dimension ``cell`` or ``point``, in the order of the file.

    Raises
    ------
    FileNotFoundError
        If the file does not exist.
    ValueError
        If the name ends otherwise, or the file holds no points.
    """
    places = places_of(read_mesh(path), centers=centers)
    return {
        a: xr.DataArray(places[:, k], dims="cell" if centers else "point")
        for k, a in enumerate(COMPONENTS)
    }
