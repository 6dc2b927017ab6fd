"""VTK PolyData and unstructured grids of any code: a point for each particle, a point or a line for each contact."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from xcg.readers.codes import mfix
from xcg.readers.engine import ReadOptions, StepRef
from xcg.scene.schema import Frame

# Arrays that other codes write for spheres: YADE's VTKRecorder, LIGGGHTS' dump custom/vtk, and what many call them.
_KNOWN = {
    "radii": "radius",
    "radius": "radius",
    "diameter": "diameter",
    "linVelVec": "velocity",
    "v": "velocity",
    "velocity": "velocity",
    "angVelVec": "angular_velocity",
    "omega": "angular_velocity",
    "mass": "mass",
    "density": "density",
    "id": "particle_id",
    "materialId": "species",
    "type": "species",
}


class Vtk(mfix.Mfix):
    """Points and lines of any code, arrays by ``names=``; files, times and series are those of MFiX."""

    READS_LINES = True

    def recognises(self, path: str) -> bool:
        """Tell unstructured grids; PolyData is taken for that of MFiX where no engine is named."""
        if Path(path).suffix != ".vtu":
            return False
        with open(path, "rb") as file:
            head = file.read(1024)
        return b"<VTKFile" in head and b"UnstructuredGrid" in head

    def index_particles(self, paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
        """List the steps of particles, one a file."""
        refs = mfix.index_files(paths, options)
        for ref in refs:
            mfix.targets(ref, "particle", _named(ref, options))
        return refs

    def read_particles(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Read the particles of one step."""
        return super().read_particles(ref, _named(ref, options))

    def read_contacts(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Read the contacts of one step as they stand: points are contact points, those of lines follow from radii."""
        return mfix.read_arrays(ref, mfix.targets(ref, "contact", options))

    def ignored_columns(self, ref: StepRef, options: ReadOptions, *, contacts: bool = False) -> list[str]:
        """Arrays of a step that are not read."""
        return super().ignored_columns(ref, options if contacts else _named(ref, options), contacts=contacts)


def _named(ref: StepRef, options: ReadOptions) -> ReadOptions:
    """Add what is known by itself to what the caller says, unless something else has that name already."""
    names = dict(options.names)
    for array, name in _KNOWN.items():
        if array in ref.columns and array not in names and name not in names.values():
            names[array] = name
    return replace(options, names=names)
