"""VTK PolyData and unstructured grids of any code: a point for each particle, a point or a line for each contact."""

from __future__ import annotations

from collections.abc import Sequence

from xcg.readers.codes.vtk_steps import is_vtk, list_steps, read_arrays, read_particle_arrays, require_contacts, targets
from xcg.readers.engine import Engine, ReadOptions, StepRef
from xcg.scene.schema import Frame

# Arrays of spheres as YADE's VTKRecorder, LIGGGHTS' dump custom/vtk and many others call them.
_PARTICLE_NAMES = {
    "radii": "radius",
    "radius": "radius",
    "Radius": "radius",
    "diameter": "diameter",
    "Diameter": "diameter",
    "linVelVec": "velocity",
    "v": "velocity",
    "velocity": "velocity",
    "Velocity": "velocity",
    "angVelVec": "angular_velocity",
    "omega": "angular_velocity",
    "mass": "mass",
    "Mass": "mass",
    "density": "density",
    "Density": "density",
    "id": "particle_id",
    "materialId": "species",
    "type": "species",
}
_ADVICE = "Say which arrays they are, as in names={'...': 'contact_i'}"


class Vtk(Engine):
    """Points and lines of any code, one step a file; arrays by ``names=``."""

    def recognises(self, path: str) -> bool:
        """Tell unstructured grids; PolyData is taken for that of MFiX where no engine is named."""
        return is_vtk(path, (".vtu",), b"UnstructuredGrid")

    def index_particles(self, paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
        """List the steps of particles from the headers of files, or of the ``.pvd`` collections that name them."""
        refs = list_steps(paths, options)
        for ref in refs:
            targets(ref, "particle", options, _PARTICLE_NAMES)
        return refs

    def index_contacts(self, paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
        """List the steps of contacts, which are points, or lines where a file holds any.

        Raises
        ------
        SceneError
            If ids or forces are not among the arrays.
        """
        refs = list_steps(paths, options, lines=True)
        for ref in refs:
            require_contacts(ref, self.contact_variables(ref, options), _ADVICE)
        return refs

    def contact_variables(self, ref: StepRef, options: ReadOptions) -> list[str]:
        """List the variables that `read_contacts` returns, from the header alone."""
        return list(targets(ref, "contact", options, {}))

    def ignored_columns(self, ref: StepRef, options: ReadOptions, *, contacts: bool = False) -> list[str]:
        """Arrays of a step that are not read."""
        found = targets(ref, "contact", options, {}) if contacts else targets(ref, "particle", options, _PARTICLE_NAMES)
        return [array for array in ref.columns if array not in found.values()]

    def read_particles(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Read the particles of one step."""
        return read_particle_arrays(ref, targets(ref, "particle", options, _PARTICLE_NAMES))

    def read_contacts(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Read the contacts of one step as they stand: points are contact points, those of lines follow from radii."""
        return read_arrays(ref, targets(ref, "contact", options, {}))
