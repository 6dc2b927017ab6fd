"""Pysammos's config.ini, read as the arguments of a job."""

from __future__ import annotations

import configparser
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from xcg.common.messages import SceneError, warn_user
from xcg.readers.files.compressed import plain_name
from xcg.scene.schema import COMPONENTS

# key_mapping: its keys and our variables
KEYS = {
    "Global_ID": "particle_id",
    "Particle_Velocity": "velocity",
    "Particle_Diameter": "diameter",
    "Particle_Density": "density",
    "Particle_Volume": "volume",
    "Particle_Mass": "mass",
    "Particle_Radius": "radius",
    "Coordination_Number": "coordination_number",
    "Particle_i_ID": "contact_i",
    "Particle_j_ID": "contact_j",
    "Force_ij": "contact_force",
    "Contact_ij": "contact_point",
}

# its kernels, however they are spelled, and the names in its output
KERNELS = {"lucy": ("lucy", "Lucy"), "gaussian": ("gaussian", "Gaussian")} | dict.fromkeys(
    ("heavyside", "heaviside"), ("heaviside", "HeavySide")
)

FAMILIES = (
    "volume_fraction", "density_mixture", "density_particle", "d32", "d43", "coordination_number", "momentum_density",
    "velocity", "velocity_gradient", "kinetic_tensor", "contact_tensor", "total_stress_tensor", "fabric_tensor",
    "shear_rate_tensor", "pressure", "granular_temperature", "inertial_number", "frictional_coefficient",
)  # fmt: skip

OF_CONTACTS = (
    "coordination_number", "contact_tensor", "total_stress_tensor", "fabric_tensor", "pressure", "inertial_number",
    "frictional_coefficient",
)  # fmt: skip

SLICES = "granular_temperature_slices"

_OFF_BY_AN_OVERLAP = "FORCE_CHAIN_CONTACT_POINT"


class _Section:
    """Section of the file: typed values, and the names that were read, so that the rest can be listed."""

    def __init__(self, path: Path, name: str, values: Mapping[str, str]) -> None:
        self.source, self.values = f"{path}: [{name}]", dict(values)
        self.known: set[str] = set()

    def get(self, key: str) -> str | None:
        self.known.add(key.lower())
        value = next((v for k, v in self.values.items() if k.lower() == key.lower()), None)
        text = None if value is None else value.split(" #")[0].split(" ;")[0].strip().strip("'\"")
        return None if text is None or text.lower() in ("", "none") else text

    def _typed(self, key: str, kind: Callable[[str], Any], expected: str) -> Any:
        text = self.get(key)
        if text is None:
            return None
        try:
            return kind(text)
        except (KeyError, ValueError):
            raise SceneError(f"{self.source} {key} = {text}: expected {expected}") from None

    def number(self, key: str) -> float | None:
        return self._typed(key, float, "a number or None")

    def whole(self, key: str) -> int | None:
        return self._typed(key, int, "a whole number")

    def flag(self, key: str, default: bool = False) -> bool:
        states = configparser.ConfigParser.BOOLEAN_STATES
        found = self._typed(key, lambda text: states[text.lower()], "True or False")
        return default if found is None else bool(found)

    def needed(self, key: str) -> str:
        found = self.get(key)
        if found is None:
            raise SceneError(f"{self.source} lacks {key}")
        return found

    def warn_of_the_rest(self) -> None:
        unknown = [key for key in self.values if key.lower() not in self.known]
        if unknown:
            warn_user(
                f"{self.source}: unknown and left out: {', '.join(unknown)}; known are {', '.join(sorted(self.known))}"
            )


def read_ini(path: Path) -> dict[str, Any]:
    """Read the arguments of `xcg.jobs.config.Job` from Pysammos's config.ini."""
    parser = configparser.ConfigParser(interpolation=None)
    parser.optionxform = str  # type: ignore[method-assign, assignment]
    try:
        parser.read_string(path.read_text(encoding="utf-8"), source=str(path))
    except configparser.Error as error:
        raise SceneError(f"{path}: {error}") from None
    names = ("paths", "timesteps", "smoothing_function", "flags", "key_mapping", "grid_info", "fields_to_export",
             "output_options")  # fmt: skip
    unknown = [name for name in parser.sections() if name not in names]
    if unknown:
        warn_user(f"{path}: unknown sections {unknown} are left out; known are {', '.join(names)}")
    sections = {name: _Section(path, name, dict(parser[name]) if parser.has_section(name) else {}) for name in names}
    paths, steps, flags, output = (sections[n] for n in ("paths", "timesteps", "flags", "output_options"))

    particles = _files(path.parent, paths.needed("particles_path"), steps, required=True)
    contacts_path = paths.get("contacts_path")
    contacts = [] if contacts_path is None else _files(path.parent, contacts_path, steps, required=False)
    scene: dict[str, Any] = {
        "particles": particles, "names": _names(sections["key_mapping"], particles[0], contacts), "engine": "mfix",
        "periodic": "".join(a for a in COMPONENTS if sections["grid_info"].flag(f"{a}_axis_periodic")),
    }  # fmt: skip
    if contacts:
        scene |= {"contacts": contacts, "missing": "empty"}
    elif contacts_path is not None:
        warn_user(f"{paths.source}: no contacts in these steps ({contacts_path}*.vtp): fields of contacts are left out")
    fields, slices = _fields(sections["fields_to_export"])
    if not contacts:
        counted = "coordination_number" in scene["names"].values()
        fields = [name for name in fields if name not in OF_CONTACTS[1 if counted else 0 :]]

    kernel, label = _kernel(sections["smoothing_function"])
    mesh = _mesh(sections["grid_info"])
    phases = None if flags.flag("partialignore", default=True) else {"max_phases": 8}
    folder = path.parent / (paths.get("output_path") or "PysammosCG")
    spelled = "vkthdf_output" if output.get("vkthdf_output") is not None else "vtkhdf_output"
    output.known |= {"vkthdf_output", "vtkhdf_output"}
    job: dict[str, Any] = {
        "scene": scene,
        "fields": {"fields": fields, "preset": "pysammos"},
        "phases": phases,
        "mesh": {"kernel": kernel, **mesh},
        "slices": slices,
        "folder": folder,
        "name": f"CG_{label}_{'Monodisperse' if phases is None else 'Polydisperse'}",
        "netcdf": output.flag("h5_output"),
        "vtkhdf": {True: "steps", False: ""}[output.flag(spelled)],
        "suffix": ".h5",
        "on_error": flags.get("on_error") or "raise",
    }
    for section in sections.values():
        section.warn_of_the_rest()
    return job


def _files(folder: Path, prefix: str, steps: _Section, *, required: bool) -> list[str]:
    """Files ``<prefix><number>.vtp``, compressed or not, whose numbers are t0, t0 + dt, ... tf."""
    start, stop, stride = (steps.whole(key) for key in ("t0", "tf", "dt"))
    at = folder / prefix
    parent, stem = (at, "") if prefix.endswith("/") else (at.parent, at.name)
    found: dict[int, str] = {}
    for file in sorted(parent.iterdir()) if parent.is_dir() else ():  # those that are not compressed come first
        match = re.fullmatch(re.escape(stem) + r"(\d+)\.vtp", plain_name(file.name))
        if match:
            found.setdefault(int(match[1]), str(file))
    chosen = [
        number
        for number in sorted(found)
        if (start is None or number >= start)
        and (stop is None or number <= stop)
        and (not stride or (number - (start or 0)) % stride == 0)
    ]
    if required and not chosen:
        there = f"numbers there: {', '.join(map(str, sorted(found)))}" if found else "there are none of that name"
        raise FileNotFoundError(
            f"{steps.source}: no file {at}<number>.vtp with t0={start}, tf={stop}, dt={stride}; {there}"
        )
    return [found[number] for number in chosen]


def _names(section: _Section, particles: str, contacts: list[str]) -> dict[str, str | None]:
    """Arrays that the files hold for our variables."""
    from xcg.readers.files.vtp import read_header

    there = {True: read_header(particles).names, False: read_header(contacts[0]).names if contacts else ()}
    names: dict[str, str | None] = {}
    for key, ours in KEYS.items():
        array = section.get(key)
        if array is None:
            continue
        of_particles = ours in ("particle_id", "radius") or not ours.startswith("contact")
        if array == _OFF_BY_AN_OVERLAP:
            warn_user(
                f"{section.source}: {array} is off by one overlap between spheres in MFiX; their contact points follow "
                "from centres and radii"
            )
        elif array in there[of_particles]:
            names[array] = ours
        elif of_particles or contacts:
            warn_user(
                f"{section.source} {key} = {array}: no such array in {particles if of_particles else contacts[0]}"
            )
    return names


def _kernel(section: _Section) -> tuple[str, str]:
    text = section.get("type") or "Lucy"
    if text.lower() not in KERNELS:
        raise SceneError(f"{section.source} type = {text}: expected Lucy, Gaussian or HeavySide")
    return KERNELS[text.lower()]


def _mesh(section: _Section) -> dict[str, Any]:
    """Find the resolved axes, the ends of their nodes unless these are automatic, and where other axes are cut."""
    dimension = section.whole("grid_dimension")
    axes = section.get("grid_axes") or "xyz"
    if set(axes) - set(COMPONENTS) or (dimension is not None and dimension != len(set(axes))):
        raise SceneError(
            f"{section.source} grid_dimension = {dimension}, grid_axes = {axes}: expected as many axes of x, y, z"
        )
    ends = {a: (section.number(f"{a}_min"), section.number(f"{a}_max")) for a in COMPONENTS}
    cuts = {a: section.number(f"{a}_transect") for a in COMPONENTS}
    if section.flag("automatic_grid"):
        return {"axes": axes}
    bounds = {}
    for a in axes:
        low, high = ends[a]
        if low is None or high is None:
            raise SceneError(
                f"{section.source}: {a}_min and {a}_max are needed with grid_axes = {axes} and automatic_grid = False"
            )
        bounds[a] = (low, high)
    at = {a: cut for a, cut in cuts.items() if a not in axes and cut is not None}
    return {"axes": axes, "bounds": bounds, "at": at}


def _fields(section: _Section) -> tuple[list[str], dict[str, Any] | None]:
    chosen = [name for name in FAMILIES if section.flag(name)]
    slices = {"axis": "y"} if section.flag(SLICES) else None
    if not chosen and slices is None:
        raise SceneError(f"{section.source}: nothing is True; switch on any of {', '.join((*FAMILIES, SLICES))}")
    return chosen, slices
