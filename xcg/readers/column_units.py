"""Units in the names of columns, such as ``x [mm]``, ``Velocity X (cm/s)``, ``x/mm`` and ``radius_um``."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import lru_cache

from xcg.scene.schema import Powers

_BRACKETS = re.compile(r"^(.*?)[\s/]*[\[({<]([^\[\](){}<>]*)[\])}>]\s*$", re.DOTALL)
_SEPARATED = re.compile(r"^(.+?)(?:\s*[/,:|]\s*|\s+in\s+)(.+)$")  # x/mm, "x, mm", x in mm
_SUFFIX = re.compile(  # x_mm, vx_mm_s, rho_kg_m3, x mm
    r"^(.+?)[_ ]([A-Za-zµμ][A-Za-z0-9µμ^/-]*(?:_(?:s|min|h|c?m[23]))?)$"
)
_FACTOR = re.compile(r"([A-Za-zµμ°]+)(-?\d)?")
_PREFIXES = {"": 1.0, "n": 1e-9, "u": 1e-6, "m": 1e-3, "c": 1e-2, "k": 1e3, "M": 1e6}
_WITH_PREFIX: dict[str, tuple[float, Powers]] = {
    "m": (1.0, (1, 0, 0)), "g": (1e-3, (0, 1, 0)), "s": (1.0, (0, 0, 1)), "N": (1.0, (1, 1, -2)),
    "Pa": (1.0, (-1, 1, -2)),
}  # fmt: skip
_UNITS: dict[str, tuple[float, Powers]] = {
    **{
        prefix + unit: (factor * of_unit, powers)
        for unit, (of_unit, powers) in _WITH_PREFIX.items()
        for prefix, factor in _PREFIXES.items()
    },
    "sec": (1.0, (0, 0, 1)), "min": (60.0, (0, 0, 1)), "h": (3600.0, (0, 0, 1)),
    "in": (0.0254, (1, 0, 0)), "ft": (0.3048, (1, 0, 0)),
    "dyn": (1e-5, (1, 1, -2)), "rad": (1.0, (0, 0, 0)), "deg": (math.radians(1), (0, 0, 0)),
    "rpm": (2 * math.pi / 60, (0, 0, -1)),
}  # fmt: skip
_RUN_TOGETHER = {"kgm-3": "kg m-3", "kgm3": "kg m-3", "kgm2": "kg m2", "ms-1": "m s-1",
                 "rads-1": "rad s-1", "mps": "m s-1", "gcm3": "g cm-3"}  # fmt: skip


# endings that may mean something else: the centre of mass, a minimum, inside
_AMBIGUOUS = {"cm", "min", "h", "in", "ft"}
_NO_UNITS = {"-", "none", "dimensionless"}


@dataclass(frozen=True)
class ColumnUnit:
    """Unit in the name of a column.

    Attributes
    ----------
    stem : str
        The name without its unit.
    text : str
        The unit as it is written.
    factor : float
        One such unit in SI.
    powers : tuple of int
        Powers of length, mass and time.
    in_brackets : bool
        Whether it is in brackets; else it is an ending, which may be part of the name.
    """

    stem: str
    text: str
    factor: float
    powers: Powers
    in_brackets: bool = True


@lru_cache(maxsize=1 << 12)
def parse_unit(text: str) -> tuple[float, Powers] | None:
    """Return the factor to SI and the powers of length, mass and time of a unit; None if it is unknown."""
    plain = text.strip().replace("²", "2").replace("³", "3").replace("µ", "u").replace("μ", "u")
    plain = re.sub(r"\^|\*\*", "", plain)
    plain = _RUN_TOGETHER.get(plain, plain)
    if plain == "-":
        return 1.0, (0, 0, 0)
    factor = 1.0
    powers = [0, 0, 0]
    above, *below = plain.split("/")
    parts = [(word, 1) for word in re.split(r"[\s.*·]+", above.strip()) if word not in ("", "1")]
    parts += [(word, -1) for words in below for word in re.split(r"[\s.*·]+", words.strip("() "))]
    if not any(word for word, _ in parts):  # "1" is the number of a component
        return None
    for word, sign in parts:
        match = _FACTOR.fullmatch(word)
        name = match[1] if match else ""
        name = name if name in _UNITS else name.lower()
        if match is None or name not in _UNITS:
            return None
        of_unit, of_powers = _UNITS[name]
        exponent = sign * int(match[2] or 1)
        factor *= of_unit**exponent
        powers = [a + exponent * b for a, b in zip(powers, of_powers, strict=True)]
    length, mass, time = powers
    return float(f"{factor:.14g}"), (length, mass, time)  # g/cm3 is 1000 kg/m3


@lru_cache(maxsize=1 << 12)
def unit_of(column: str) -> ColumnUnit | None:
    """Return the unit in the name of a column, in brackets, behind a sign or at its end; None if unknown."""
    match = _BRACKETS.match(column)
    if match is not None:
        unit = parse_unit(match[2])
        if unit is None or not match[1].strip():
            return None
        return ColumnUnit(match[1].strip(), match[2], *unit)
    for pattern in (_SEPARATED, _SUFFIX):
        match = pattern.match(column)
        text = match[2] if match is not None else ""
        unit = parse_unit(text.replace("_", "/", 1))
        is_ambiguous = pattern is _SUFFIX and text in _AMBIGUOUS
        if match is not None and unit is not None and not is_ambiguous:
            return ColumnUnit(match[1].strip(), text, *unit, in_brackets=False)
    return None


def with_unit(name: str, unit: str) -> str:
    """Return the name of a column with the unit that its metadata hold in brackets, unless it names one."""
    is_unit = parse_unit(unit) is not None or re.fullmatch(r"[^\W\d]\S*", unit) is not None
    if not is_unit or unit.lower() in _NO_UNITS or unit_of(name) is not None:
        return name
    return f"{name} [{unit}]"


def names_unknown_unit(column: str) -> bool:
    """Return whether a word in brackets, or an ending such as _cm, may be a unit that is not read."""
    match = _BRACKETS.match(column) or _SUFFIX.match(column)
    if match is None or unit_of(column) is not None:
        return False
    in_brackets = column.rstrip().endswith(("]", ")", "}", ">"))
    return match[2] == "cm" or (in_brackets and re.fullmatch(r"[^\W\d]\S*", match[2]) is not None)
