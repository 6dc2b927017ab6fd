"""MFiX-DEM: region output in ``.vtp`` files (particles, force chains) and ``.pvd`` lists of them.

What its contacts hold was checked on its output, against the positions of the particles.

- Contacts of spheres hold no contact point: the points of the mesh are the middle of the two
  centres, and ``FORCE_CHAIN_CONTACT_POINT`` is off by one overlap. It follows from centres and
  radii.
- Contacts of superquadrics have theirs in ``FORCE_CHAIN_CONTACT_POINT``; the points of the mesh lie
  midway between it and a centre.
- ``FORCE_CHAIN_ORIENTATION`` is ``FN / |FN|``: it points from j to i, except in the hundredth of
  the contacts whose damping outweighs repulsion, where it points the other way. Of superquadrics it
  is another direction. So it is not read as the normal.
- Contacts are one time step older than positions, so a point may lie a period away from a particle
  i that just crossed.
- Many contacts stand twice: see `xcg.readers.engines.mfix_contacts`.
- ``QUATERNION`` (w, x, y, z) turns the axes of the body to the axes of space, and half-axes are those
  of the phase times ``SQP_POLY_SCALE``: so contact points of superquadrics lie on their surfaces.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.engines.mfix_contacts import (
    EXACT,
    both_sides_once,
    distances_of_twins,
    each_contact_once,
    of_superquadrics,
    periods_of,
)
from xcg.readers.engines.vtk import Vtk, is_xml, open_step
from xcg.readers.engines.vtk_steps import packed_path
from xcg.readers.files.text import open_binary
from xcg.readers.files.vtkheader import read_arrays
from xcg.readers.files.vtp import read_collection
from xcg.readers.names import OF_MFIX
from xcg.scene.frame import entries_of
from xcg.scene.schema import COMPONENTS, Frame, variable

_NORMAL = "FORCE_CHAIN_FN"
_TANGENTIAL = "FORCE_CHAIN_FT"
_OVERLAP = "FORCE_CHAIN_OVERLAP"
_POINT = "FORCE_CHAIN_CONTACT_POINT"
_LENGTH = "FORCE_CHAIN_LENGTH"
_OF_CONTACTS = {_NORMAL, _TANGENTIAL, _OVERLAP, _POINT, _LENGTH}

_SHAPES = "SQP_"  # begins the names of the shapes that files of superquadrics list, by phase: three half-axes, m, n
# in the headers of its files only
_MARKS = re.compile(
    rb'<!--\s*Time\s*=|Name="(FORCE_CHAIN_|Particle_(Phase_)?ID"|coordinates"|Angular_velocity")'
)
_HEAD = 1 << 14
_QUATERNION = "QUATERNION"
_SCALE = "SQP_POLY_SCALE"
_PHASE = "Particle_Phase_ID"
_SHAPE = (_QUATERNION, _SCALE, _PHASE)


class Mfix(Vtk):
    """Region output of MFiX-DEM."""

    OPTIONS: ClassVar = ()
    CONTACT_SLOTS: ClassVar = OF_MFIX
    LINES = False
    ADVICE = (
        "Expected FORCE_CHAIN_GLOBAL_ID1 and _ID2, and FORCE_CHAIN_FC (or FORCE_CHAIN_FN and FORCE_CHAIN_FT): switch "
        "them on in the region's output, or map others with names={'...': 'contact_i'}"
    )

    def recognises(self, path: str) -> bool:
        """Return whether this is PolyData with the names or the comment of MFiX, or a collection of such files."""
        if is_xml(path, (".pvd",), b"Collection"):
            files = [packed_path(file) for listed, _ in read_collection(path) for file in listed]
            path = next(filter(os.path.isfile, files), "")
        if not path or not is_xml(path, (".vtp",), b"PolyData"):
            return False
        with open_binary(path) as file:
            return _MARKS.search(file.read(_HEAD)) is not None

    def contact_variables(self, ref: StepRef, options: ReadOptions) -> list[str]:
        """List the variables that `read_contacts` returns, from the header alone."""
        names = super().contact_variables(ref, options)
        if {_NORMAL, _TANGENTIAL} <= set(ref.columns) and "contact_force" not in names:
            names.append("contact_force")
        return names

    def targets(
        self, ref: StepRef, options: ReadOptions, *, contacts: bool = False
    ) -> dict[str, str]:
        """Scene names and the arrays that they are read from; of particles also the arrays of their shapes."""
        targets = super().targets(ref, options, contacts=contacts)
        if not contacts:
            free = set(ref.columns) - set(options.names)
            targets |= {array: array for array in _SHAPE if array in free}
        return targets

    def columns_read(self, ref: StepRef, options: ReadOptions, *, contacts: bool) -> dict[str, str]:
        """Return the variable of each array that is read, including the keys that join contacts to particles."""
        of_contacts = dict.fromkeys(_OF_CONTACTS, "contact") if contacts else {}
        return of_contacts | super().columns_read(ref, options, contacts=contacts)

    def read_particles(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Parse the particles of one step.

        Returns
        -------
        dict
            Float64 arrays by scene name, shape (n,) or (n, 3), rows as in the file.

        Raises
        ------
        SceneError
            If the file is damaged or changed since it was indexed, or ids are too large for
            Float32.
        """
        frame = super().read_particles(ref, options)
        shapes = {array: frame.pop(array) for array in _SHAPE if array in frame}
        frame |= _shapes(ref, shapes)
        ids = frame.get("particle_id", np.empty(0))
        if ids.size and ids.max() >= EXACT and len(np.unique(ids)) < len(ids):
            raise SceneError(
                f"{ref.path}: particle ids from {EXACT} on occur more than once, because MFiX writes ids as "
                "Float32, which holds whole numbers up to there only; write a region with fewer particles, or "
                "drop the ids with names={'Particle_ID': None}"
            )
        return frame

    def read_contacts(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Parse the contacts of one step, each contact once.

        Returns
        -------
        dict
            Float64 arrays by scene name, shape (n,) or (n, 3), rows in the order of the file,
            spheres first. Where ``point_is_middle`` (n,) is true, ``contact_point`` is the middle
            of the centres of two spheres; `names` that map an array to ``contact_point`` are
            believed. ``row_of_file`` (n,) counts rows of the file.

        Raises
        ------
        SceneError
            If the file is damaged or changed since it was indexed, or holds superquadrics without
            contact points.
        """
        if not ref.rows:  # files without contacts may lack the arrays
            names = self.contact_variables(ref, options)
            return {name: np.empty(variable(name).shape(0)) for name in names}
        raw = _RawContacts.of(ref, options, self.targets(ref, options, contacts=True))
        spheres = np.flatnonzero(~raw.superquadric)
        others = np.flatnonzero(raw.superquadric)
        frame = entries_of(raw.frame, spheres)
        frame = each_contact_once(frame, raw.mark[spheres], raw.point[spheres])
        if not len(others):
            return frame
        sides = entries_of(raw.frame, others)
        joined = both_sides_once(sides, raw.point[others], raw.length[others], _periods(raw))
        return {name: np.concatenate([frame[name], joined[name]]) for name in frame}

    def recover_periods(self, ref: StepRef, options: ReadOptions) -> dict[str, float]:
        """Periods by axis, from contacts whose two rows stand on either side of an edge, one period apart.

        The extent of the particles' centres is not a period: it is short by about a diameter.
        """
        if not ref.rows:
            return {}
        return _periods(_RawContacts.of(ref, options, self.targets(ref, options, contacts=True)))


def _shapes(ref: StepRef, arrays: Frame) -> Frame:
    """Return quaternions, half-axes and exponents of superquadrics.

    Exponents m and n are returned where they are equal only, as their order could not be checked.
    """
    frame: Frame = {}
    if _QUATERNION in arrays:
        frame |= {f"quat_{axis}": arrays[_QUATERNION][:, k].copy() for k, axis in enumerate("wxyz")}
    if _SCALE not in arrays or _PHASE not in arrays:
        return frame
    listed = {
        name.removeprefix(_SHAPES): numbers for name, numbers in open_step(ref).fields.items()
    }
    phases, index = np.unique(arrays[_PHASE].astype("int64"), return_inverse=True)
    shapes = [listed.get(f"{phase:02d}", ()) for phase in phases]
    if not shapes or any(len(numbers) != 5 for numbers in shapes):
        return frame
    x, y, z, m, n = np.array(shapes)[index].T
    for axis, half_axis in zip(COMPONENTS, (x, y, z), strict=True):
        frame[f"half_axis_{axis}"] = half_axis * arrays[_SCALE]
    if (m == n).all():
        frame |= {"exponent_1": m.copy(), "exponent_2": n.copy()}
    return frame


@dataclass(frozen=True, eq=False)
class _RawContacts:
    """Contacts of a file as they stand.

    Attributes
    ----------
    frame : Frame
        Arrays by scene name.
    mark : array (n, 3) or (n,)
        What the two rows of a contact of spheres share, see `each_contact_once`.
    point : array (n, 3)
        Contact points of superquadrics, middle of the centres of spheres (m).
    length : array (n,)
        ``FORCE_CHAIN_LENGTH`` (m), see `of_superquadrics`; zero where it is not there.
    superquadric : array (n,)
        Whether each is a contact of superquadrics.
    """

    frame: Frame
    mark: NDArray
    point: NDArray
    length: NDArray
    superquadric: NDArray

    @classmethod
    def of(cls, ref: StepRef, options: ReadOptions, targets: Mapping[str, str]) -> _RawContacts:
        header = open_step(ref)
        points = header.names[0]
        more = sorted(_OF_CONTACTS & set(header.names))
        arrays = read_arrays(header, [*targets.values(), points, *more])
        frame: Frame = {name: arrays[array] for name, array in targets.items()}
        if "contact_force" not in frame:
            frame["contact_force"] = arrays[_NORMAL] + arrays[_TANGENTIAL]
        mark = arrays.get(_NORMAL, arrays.get(_OVERLAP, frame["contact_force"]))
        point = arrays[points]
        length = arrays.get(_LENGTH, np.zeros(header.count))
        superquadric = np.zeros(header.count, bool)
        if {_POINT, _LENGTH} <= set(arrays):
            superquadric = of_superquadrics(point, arrays[_POINT], length)
            point = np.where(superquadric[:, None], arrays[_POINT], point)
        elif any(name.startswith(_SHAPES) for name in header.fields):
            raise SceneError(
                f"{ref.path}: contacts of superquadrics need {_POINT} and {_LENGTH}, which tell where they touch; "
                f"found {list(ref.columns)}. Switch them on in the region's output"
            )
        if targets.get("contact_point") == points and points not in options.names:
            frame |= {"contact_point": point, "point_is_middle": ~superquadric}
        frame["row_of_file"] = np.arange(header.count)
        return cls(frame, mark, point, length, superquadric)


def _periods(raw: _RawContacts) -> dict[str, float]:
    return periods_of(
        distances_of_twins(raw.frame, raw.mark, raw.point, raw.superquadric), raw.point
    )
