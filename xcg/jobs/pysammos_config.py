"""Jobs in ``config.ini`` of Pysammos."""

from __future__ import annotations

import configparser
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from xcg.common.messages import SceneError, warn_user
from xcg.fields.presets.pysammos import rows
from xcg.jobs.job import Job
from xcg.readers.files.text import plain_name
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
KERNELS = {
    "lucy": ("lucy", "Lucy"),
    "gaussian": ("gaussian", "Gaussian"),
    "heavyside": ("heaviside", "HeavySide"),
    "heaviside": ("heaviside", "HeavySide"),
}

OF_CONTACTS = (
    "coordination_number",
    "contact_tensor",
    "total_stress_tensor",
    "fabric_tensor",
    "pressure",
    "inertial_number",
    "frictional_coefficient",
)

FAMILIES = tuple(dict.fromkeys(row.family for row in rows("xy", "xyz").values()))
SLICES = "granular_temperature_slices"

_OFF_BY_AN_OVERLAP = "FORCE_CHAIN_CONTACT_POINT"


class _Section:
    """Section of the file: typed values, and the keys that were read, to list the others."""

    def __init__(self, path: Path, name: str, values: Mapping[str, str]) -> None:
        self.source = f"{path}: [{name}]"
        self.values = values
        self.read: set[str] = set()

    def get(self, key: str) -> str | None:
        self.read.add(key.lower())
        text = self.values.get(key, "").strip("'\"")
        if text.lower() in ("", "none"):
            return None
        return text

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
        state = self._typed(key, lambda text: states[text.lower()], "True or False")
        if state is None:
            return default
        return bool(state)

    def needed(self, key: str) -> str:
        text = self.get(key)
        if text is None:
            raise SceneError(f"{self.source} lacks {key}")
        return text

    def warn_of_unread(self) -> None:
        """Warn of keys that nothing asked for."""
        unread = [key for key in self.values if key not in self.read]
        if unread:
            warn_user(
                f"{self.source}: unknown and left out: {', '.join(unread)}; known are "
                f"{', '.join(sorted(self.read))}"
            )


_SECTIONS = (
    "paths",
    "timesteps",
    "smoothing_function",
    "flags",
    "key_mapping",
    "grid_info",
    "fields_to_export",
    "output_options",
)


def read_ini(path: Path) -> Job:
    """Read a job from Pysammos's ``config.ini``; raise SceneError naming section and key."""
    sections = _sections_of(path)
    scene = _scene(path, sections)
    fields, slices = _fields(sections["fields_to_export"], scene)
    kernel, label = _kernel(sections["smoothing_function"])
    flags = sections["flags"]
    phases = None
    mixture = "Monodisperse"
    if not flags.flag("partialignore", default=True):
        phases = {"max_phases": 8}
        mixture = "Polydisperse"
    output = sections["output_options"]
    # the first is Pysammos's own spelling
    has_vtkhdf = any([output.flag("vkthdf_output"), output.flag("vtkhdf_output")])
    job = Job(
        scene=scene,
        fields={"fields": fields, "preset": "pysammos"},
        phases=phases,
        mesh={"kernel": kernel, **_mesh(sections["grid_info"])},
        slices=slices,
        folder=path.parent / (sections["paths"].get("output_path") or "PysammosCG"),
        name=f"CG_{label}_{mixture}",
        netcdf=output.flag("h5_output"),
        vtkhdf="steps" if has_vtkhdf else "",
        suffix=".h5",
        on_error=flags.get("on_error") or "raise",  # type: ignore[arg-type]
    )
    for section in sections.values():
        section.warn_of_unread()
    return job


def _sections_of(path: Path) -> dict[str, _Section]:
    """Return all sections of the file, empty where it lacks them; warn of unknown ones."""
    parser = configparser.ConfigParser(interpolation=None, inline_comment_prefixes=("#", ";"))
    parser.read_dict({name: {} for name in _SECTIONS})
    try:
        parser.read_string(path.read_text(encoding="utf-8"), source=str(path))
    except configparser.Error as error:
        raise SceneError(f"{path}: {error}") from None
    unknown = [name for name in parser.sections() if name not in _SECTIONS]
    if unknown:
        expected = ", ".join(_SECTIONS)
        warn_user(f"{path}: unknown sections {unknown} are left out; known are {expected}")
    return {name: _Section(path, name, parser[name]) for name in _SECTIONS}


def _fields(export: _Section, scene: Mapping[str, Any]) -> tuple[list[str], dict[str, str] | None]:
    """Return the fields that are switched on and that the scene allows, and the options of slices, if any."""
    fields = [name for name in FAMILIES if export.flag(name)]
    slices = None
    if export.flag(SLICES):
        slices = {"axis": "y"}
    if not fields and slices is None:
        choices = ", ".join((*FAMILIES, SLICES))
        raise SceneError(f"{export.source}: nothing is True; switch on any of {choices}")
    impossible: set[str] = set()
    if "contacts" not in scene:
        impossible = set(OF_CONTACTS)
        if "coordination_number" in scene["names"].values():
            impossible -= {"coordination_number"}
    return [name for name in fields if name not in impossible], slices


def _kernel(section: _Section) -> tuple[str, str]:
    """Return the name of the kernel, and its name in Pysammos's output."""
    spelling = section.get("type") or "Lucy"
    if spelling.lower() not in KERNELS:
        raise SceneError(
            f"{section.source} type = {spelling}: expected Lucy, Gaussian or HeavySide"
        )
    return KERNELS[spelling.lower()]


def _scene(path: Path, sections: Mapping[str, _Section]) -> dict[str, Any]:
    """Return the arguments of `xcg.open_scene`; warn if the files of contacts do not exist."""
    paths = sections["paths"]
    steps = sections["timesteps"]
    particles = _files(path.parent, paths.needed("particles_path"), steps, required=True)
    contacts: list[str] = []
    contacts_path = paths.get("contacts_path")
    if contacts_path is not None:
        contacts = _files(path.parent, contacts_path, steps, required=False)
    box = sections["grid_info"]
    scene: dict[str, Any] = {
        "particles": particles,
        "names": _names(sections["key_mapping"], particles[0], contacts),
        "engine": "mfix",
        "periodic": "".join(a for a in COMPONENTS if box.flag(f"{a}_axis_periodic")),
    }
    if contacts:
        scene |= {"contacts": contacts, "missing": "empty"}
    elif contacts_path is not None:
        warn_user(
            f"{paths.source}: no contacts in these steps ({contacts_path}*.vtp): "
            "fields of contacts are left out"
        )
    return scene


def _files(folder: Path, prefix: str, steps: _Section, *, required: bool) -> list[str]:
    """Files ``<prefix><number>.vtp``, compressed or not, whose numbers are t0, t0 + dt, ... tf."""
    start = steps.whole("t0")
    stop = steps.whole("tf")
    stride = steps.whole("dt")
    pattern = folder / prefix
    parent = pattern.parent
    stem = pattern.name
    if prefix.endswith("/"):
        parent = pattern
        stem = ""
    by_number: dict[int, str] = {}
    # files that are not compressed come first
    for file in sorted(parent.glob("*")):
        match = re.fullmatch(re.escape(stem) + r"(\d+)\.vtp", plain_name(file.name))
        if match:
            by_number.setdefault(int(match[1]), str(file))
    numbers = sorted(by_number)
    chosen = [
        number
        for number in numbers
        if (start is None or number >= start)
        and (stop is None or number <= stop)
        and (not stride or (number - (start or 0)) % stride == 0)
    ]
    if required and not chosen:
        existing = "there are none of that name"
        if numbers:
            existing = f"numbers there: {', '.join(map(str, numbers))}"
        raise FileNotFoundError(
            f"{steps.source}: no file {pattern}<number>.vtp with t0={start}, tf={stop}, "
            f"dt={stride}; {existing}"
        )
    return [by_number[number] for number in chosen]


def _names(section: _Section, particles: str, contacts: list[str]) -> dict[str, str | None]:
    """Arrays that the files hold for our variables."""
    from xcg.readers.files.vtp import read_header

    files = {"particles": particles}
    if contacts:
        files["contacts"] = contacts[0]
    arrays = {kind: read_header(file).names for kind, file in files.items()}
    names: dict[str, str | None] = {}
    for key, ours in KEYS.items():
        array = section.get(key)
        kind = "contacts" if ours.startswith("contact") else "particles"
        if array is None:
            continue
        if array == _OFF_BY_AN_OVERLAP:
            warn_user(
                f"{section.source}: {array} is off by one overlap between spheres in MFiX; "
                "their contact points follow from centres and radii"
            )
        elif array in arrays.get(kind, ()):
            names[array] = ours
        elif kind in files:
            warn_user(f"{section.source} {key} = {array}: no such array in {files[kind]}")
    return names


def _mesh(section: _Section) -> dict[str, Any]:
    """Return the resolved axes, their bounds unless automatic, and where other axes are cut."""
    dimension = section.whole("grid_dimension")
    axes = section.get("grid_axes") or "xyz"
    if set(axes) - set(COMPONENTS) or (dimension is not None and dimension != len(set(axes))):
        raise SceneError(
            f"{section.source} grid_dimension = {dimension}, grid_axes = {axes}: "
            "expected as many axes of x, y, z"
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
                f"{section.source}: {a}_min and {a}_max are needed with grid_axes = {axes} "
                "and automatic_grid = False"
            )
        bounds[a] = (low, high)
    at = {a: cut for a, cut in cuts.items() if a not in axes and cut is not None}
    return {"axes": axes, "bounds": bounds, "at": at}
