"""VTK PolyData and unstructured grids of any code: steps in lists of files, globs and .pvd collections."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np
import xarray as xr

from xcg.common.messages import SceneError, warn_user
from xcg.common.vtk_mesh import points_of, read_mesh
from xcg.readers.assigned import magnitudes
from xcg.readers.columns import unify_sizes
from xcg.readers.engine import Engine, ReadOptions, StepRef
from xcg.readers.engines import vtkhdf_points
from xcg.readers.engines.vtk_steps import LINES, list_steps, read_header
from xcg.readers.filenames import suffix_of
from xcg.readers.files import vtkheader
from xcg.readers.files.hdf5data import is_hdf5
from xcg.readers.files.legacy_vtk import is_legacy
from xcg.readers.files.text import open_binary
from xcg.readers.files.vtkheader import OF_CELLS, Header
from xcg.readers.named_columns import columns_by_name, factor_of
from xcg.readers.names import CONTACT_ARRAYS, PARTICLE_ARRAYS, Slots, components, slots_for
from xcg.scene.frame import entries_of
from xcg.scene.schema import COMPONENTS, Frame, variable

_VECTORS = ("velocity", "angular_velocity", "unwrapped_position", "image")
_PARTS = ("normal_force", "tangential_force")  # of contact forces
# arrays that mark points which another piece holds, too
_GHOSTS = ("vtkGhostType", "vtkGhostLevels")
_XML = (".vtu", ".vtp", ".pvd", ".pvtu", ".pvtp", ".vtm", ".vti", ".vtr", ".vts")


def is_xml(path: str, suffixes: Sequence[str], *kinds: bytes) -> bool:
    """Return whether a VTK XML file has one of these suffixes, before that of a compression, and one of these kinds."""
    if suffix_of(path) not in suffixes:
        return False
    with open_binary(path) as file:
        head = file.read(1024)
    return b"<VTKFile" in head and any(kind in head for kind in kinds)


def open_step(ref: StepRef) -> Header:
    """Read the header of a step again, which has to be as it was."""
    header = read_header(ref.path, lines=ref.kind == LINES)
    if header.count != ref.rows or (ref.rows and header.names != ref.columns):
        raise SceneError(
            f"{ref.path}: the file changed after the scene was opened; open the scene again"
        )
    return header


def read_arrays(ref: StepRef, wanted: Mapping[str, str]) -> Frame:
    """Read the arrays of one step by the names of the scene, without the points that another piece holds."""
    if not ref.rows:  # files without grains may lack the arrays
        return {name: np.empty(variable(name).shape(0)) for name in wanted}
    ghosts = [name for name in _GHOSTS if name in ref.columns]
    names = [*wanted.values(), *ghosts]
    if ref.kind == vtkhdf_points.KIND:
        arrays = vtkhdf_points.read_arrays(ref, names)
    else:
        arrays = vtkheader.read_arrays(open_step(ref), names)
    frame = {name: arrays[array] for name, array in wanted.items()}
    if ghosts:
        of_piece = arrays[ghosts[0]] == 0
        frame = entries_of(frame, of_piece)
    return frame


class Vtk(Engine):
    """Points and lines of any code, one step a file; arrays by ``names=``.

    Attributes
    ----------
    PARTICLE_SLOTS, CONTACT_SLOTS : mapping
        Arrays that are taken for variables of the scene without ``names=``, see
        `xcg.readers.names`.
    LINES : bool
        Whether contacts are lines where a file holds any; else they are points.
    ADVICE : str
        What to do about contacts without ids or forces, a sentence.
    """

    PARTICLE_SLOTS: ClassVar[Slots] = PARTICLE_ARRAYS
    CONTACT_SLOTS: ClassVar[Slots] = CONTACT_ARRAYS
    WHOLE_VECTORS = True
    OPTIONS: ClassVar[tuple[str, ...]] = ("timestep",)
    LINES = True
    ROWS_ARE_IDS = False
    ADVICE = "Say which arrays they are, as in names={'...': 'contact_i'}"

    def recognises(self, path: str) -> bool:
        """Return whether this is a VTK file of points, or a list of such files."""
        if is_hdf5(path):
            return suffix_of(path) == ".vtkhdf" or vtkhdf_points.has_group(path)
        is_list = suffix_of(path) == ".series"
        return is_list or is_legacy(path) or is_xml(path, _XML, b"VTKFile")

    def index_particles(self, paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
        """List the steps of particles from the headers of files, or of the lists that name them.

        Parameters
        ----------
        paths : sequence of str
            Files of one region; or lists of them (``.pvd``, ``.series``), whose times are taken
            where the files say none; or files that name the pieces of a step (``.pvtu``,
            ``.pvtp``).
        options : ReadOptions
            ``extra["missing"]`` is "raise" (default) or "skip": what to do about files that do not
            exist. ``extra["timestep"]`` gives times to files without them.

        Raises
        ------
        SceneError
            If files are missing, damaged, of several regions, or none holds grains.

        Warns
        -----
        SceneWarning
            For files that are missing or hold no grains, which are skipped, and arrays of cells
            that are not read.
        """
        refs = list_steps(paths, options)
        for ref in refs:
            self.targets(ref, options)
        if not refs:  # all faulty, which is tolerated
            return refs
        first = refs[0]
        of_cells = [array for array in first.columns if array.endswith(OF_CELLS)]
        if of_cells:
            arrays = [array.removesuffix(OF_CELLS) for array in of_cells]
            cause = (
                "they are arrays of grains only where each point has one vertex, in .vtk, .vtp and .vtu files. If "
                "they belong to grains, write arrays of points"
            )
            if {"contact_i", "contact_j"} <= columns_by_name(arrays, self.CONTACT_SLOTS).keys():
                cause = (
                    "they are those of contacts as lines, most likely, whose ends were read as grains: give this file "
                    "as contacts=, beside that of the grains"
                )
            warn_user(f"{first.path}: arrays of cells are not read ({', '.join(arrays)}); {cause}")
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
            names = self.contact_variables(ref, options)
            needed = ("contact_i", "contact_j", "contact_force")
            lacking = [name for name in needed if name not in names]
            if lacking:
                raise SceneError(
                    f"{ref.path}: contacts lack {lacking}; found {list(ref.columns)}. {self.ADVICE}"
                )
        return refs

    def contact_columns(self, ref: StepRef, options: ReadOptions) -> dict[str, str]:
        """Return the arrays of the variables of contacts by their names."""
        return self.targets(ref, options, contacts=True)

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
        free = [array for array in ref.columns if array not in options.names]
        slots = self.CONTACT_SLOTS if contacts else slots_for(free, self.PARTICLE_SLOTS)
        for name, array in columns_by_name(free, slots).items():
            if name[:-2] not in targets:
                targets.setdefault(name, array)
        return {
            name: array for name, array in targets.items() if not name.startswith(options.unwanted)
        }

    def contact_variables(self, ref: StepRef, options: ReadOptions) -> list[str]:
        """List the variables that `read_contacts` returns, from the header alone."""
        targets = self.targets(ref, options, contacts=True)
        names = [name for name in targets if name not in _PARTS]
        if "normal_force" in targets and "contact_force" not in names:
            names.append("contact_force")
        return names

    def columns_read(self, ref: StepRef, options: ReadOptions, *, contacts: bool) -> dict[str, str]:
        """Return the variable of each array that is read, with marks of points that another piece holds."""
        targets = self.targets(ref, options, contacts=contacts)
        return dict.fromkeys(_GHOSTS, "copy") | {array: name for name, array in targets.items()}

    def read_particles(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Read the particles of one step; radii become diameters, and components vectors."""
        frame = self._read(ref, options, contacts=False)
        for vector in _VECTORS:
            parts = {name: frame.pop(name) for name in components(vector) if name in frame}
            if parts:
                if vector not in frame and len(parts) < len(COMPONENTS):
                    raise SceneError(
                        f"{ref.path}: {', '.join(parts)} of the {vector.replace('_', ' ')}, and not all "
                        "three components; drop them by names={'...': None}"
                    )
                frame.setdefault(vector, np.stack([*parts.values()], axis=1))
        inertia = frame.get("moment_of_inertia", np.empty(0))
        if inertia.ndim > 1 and "moment_of_inertia" not in options.names.values():
            del frame["moment_of_inertia"]  # a tensor, or its principal values
        if "image" in frame and frame["image"].ndim == 1 and "image" not in options.names.values():
            del frame["image"]  # a number named "i" is something else
        unify_sizes(frame, ref)
        return frame

    def read_contacts(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Read the contacts of one step as they stand: points are contact points; on lines they follow from radii."""
        frame = self._read(ref, options, contacts=True)
        parts = [frame.pop(name) for name in _PARTS if name in frame]
        forces = [frame["contact_force"]] if "contact_force" in frame else parts
        if any(force.ndim == 1 for force in forces):
            targets = self.targets(ref, options, contacts=True)
            raise SceneError(f"{ref.path}: {magnitudes(targets)}")
        frame["contact_force"] = sum(forces[1:], forces[0])
        return frame

    def _read(self, ref: StepRef, options: ReadOptions, *, contacts: bool) -> Frame:
        """Read the arrays of a step, those with a unit in their names in SI."""
        targets = self.targets(ref, options, contacts=contacts)
        frame = read_arrays(ref, targets)
        for name, array in targets.items():
            factor = 1.0 if "units" in options.given else factor_of(array, name)
            if factor != 1:
                frame[name] = frame[name] * factor
        return frame


def mesh_points(path: str | os.PathLike[str], *, centers: bool = False) -> dict[str, xr.DataArray]:
    """Points of a mesh or surface, or the centres of its cells, as `coarse_grain` takes them: ``at=mesh_points(...)``.

    `to_vtu` writes the fields at them back onto the mesh.

    Parameters
    ----------
    path : str or path
        A file that VTK reads: ``.vtu``, ``.vtp``, ``.vts``, ``.vtr``, ``.vti``, ``.vtk``, ``.stl``,
        ``.obj``, ``.ply``.
    centers : bool
        Take the centres of cells (VTK's parametric centres, as ParaView's filter "Cell Centers"),
        where codes of finite volumes keep their fields; else the points.

    Returns
    -------
    dict
        Coordinates ``x``, ``y`` and ``z`` (m) with the dimension ``cell`` or ``point``, in the
        order of the file.

    Raises
    ------
    FileNotFoundError
        If the file does not exist.
    ValueError
        If the name ends otherwise, or the file holds no points.
    """
    points = points_of(read_mesh(path), centers=centers)
    dim = "cell" if centers else "point"
    return {axis: xr.DataArray(points[:, k], dims=dim) for k, axis in enumerate(COMPONENTS)}
