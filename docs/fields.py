"""Writes what the documentation says of all fields from the rows of the registry: python docs/fields.py.

These are the page docs/fields.md and the part of docs/evaluation.md between two marks.
"""

import re
import runpy
from pathlib import Path

from xcg.fields.formulas.field import Field, Options
from xcg.fields.formulas.registry import FIELDS, TOPICS, listed
from xcg.fields.formulas.rules import takes_covariance

HEAD = r"""# Fields

`ds.cg.coarse_grain(["density", "velocity"])` computes fields by name. Without names it computes all fields below that
the scene and the arguments allow, except those marked \*. Symbols, shapes and missing values are explained [at the
end](#notation).
"""
TABLE = """
| field | meaning and formula | kind | unit | additive | averages |
|---|---|---|---|---|---|
"""
TAIL = r"""
## Notation

Psi is the kernel, and sums run over all grains and periodic images that reach the node. $f_{ij}$ is the force on i by
j, $a_{ij} = r_i - c$ the vector from the contact point c to the centre, n the unit normal of a contact, l the length of
a branch, $z_i$ the number of partners, D the dimension of the scene. [Standard errors](width.md#standard-errors)
defines S, $\Theta$ and $N_\mathrm{left}$. In a one-layer scene D = 2, and traces run over the two axes of the plane.

- Vectors have the dimension `component`. Tensors have `component` (of the force or velocity) and `direction` (of the
  face or derivative), so `stress.sel(component="x", direction="z")` is sigma_xz. Compression is positive.
- The *additive* fields of all phases add up to that of the bulk.
- The last column is the rule for [averages](evaluation.md#averages-with-standard-errors): sums as they are or, if they
  contain the kinetic stress, about the averaged velocity, ratios weighted by a sum, all others computed anew from
  averages.
- At nodes that no grain reaches, sums are zero and ratios are NaN. `sample_count` is the number of grains that reach
  a node.
- A velocity gradient is NaN along directions that the grains at a node do not span. A temperature is NaN where the
  grains are too few for its [correction](theory.md), that is, where rho_T (`fluctuation_density`) is less than half
  of what one grain contributes to rho on average.
- Friction coefficient and inertial number are NaN where p <= 0.
- Fields under *Displacement and strain* compare two steps; [`ds.cg.displacement`](displacement.md) computes them.
- `viscous_number` and `relative_viscosity` need `fluid_viscosity=`, `sliding_share` and
  `friction_mobilisation` need `friction=`. `concentration`, `segregation_flux`,
  `interphase_force` and `contact_stress_by_pair` need `by=`.

[Theory](theory.md) derives the formulas and lists [variants of definitions](theory.md#variants-of-definitions). [Custom
fields](custom.md) and [any variable of the scene](custom.md#any-variable) are computed by name as well. These tables
are made by `python docs/fields.py`; `xcg fields` prints all formulas.
"""
# headings of the topics, and pages that say more
TITLES = {
    "flow": "Density, velocity and granular temperature",
    "contacts": "Contact stress, fabric and phases",
    "rheology": "Stress, pressure and rheology",
    "energy": "Vorticity, spin and energy",
    "orientation": "Orientation of rods",
    "displacement": "Displacement and strain",
    "errors": "Standard errors",
}
PAGES = {
    "flow": "[granular temperature](temperature.md)",
    "contacts": "[walls](walls.md), [fabric](microstructure.md#fabric-and-its-anisotropies), [phases](phases.md)",
    "rheology": "[variants of definitions](theory.md#variants-of-definitions)",
    "energy": "[vorticity, spin and energy](temperature.md#vorticity-spin-and-energy)",
    "orientation": "[rods and other shapes](microstructure.md#rods-and-other-shapes)",
    "displacement": "[strain and displacement](displacement.md)",
    "errors": "[standard errors](width.md#standard-errors)",
}
KINDS = ("scalar", "vector", "tensor")
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


ROOT = Path(__file__).parents[1]
mathematics = runpy.run_path(str(Path(__file__).with_name("formula.py")))["mathematics"]
FIRST, LAST = "<!-- python docs/fields.py writes this -->\n", "<!-- until here -->\n"


def table() -> str:
    """The page, as text."""
    shown = set(listed(registered=False))
    parts = [HEAD]
    for topic in TOPICS:
        room = topic.__name__.rpartition(".")[2]
        parts.append(f"\n## {TITLES[room]}\n")
        parts.append(f"\nMore: {PAGES[room]}.\n" if room in PAGES else "")
        parts.append(TABLE)
        parts += [_row(name) for name in topic.ROWS if name in shown]
    return "".join([*parts, TAIL])


def _row(name: str) -> str:
    """One row of a table."""
    f = FIELDS[name]
    additive = "yes" if f.additive else ""
    whose = " of the bulk" if f.by_bulk else ""
    average = _of_sums(f) if f.additive else f"by `{f.weight}`{whose}" if f.weight else "anew"
    average += ", harmonic" if f.harmonic else ""
    unit = re.sub(r"\^(-?\d)", lambda power: power[1].translate(RAISED), f.units)
    about = f"{f.long_name}<br>{mathematics(f.formula)}"
    if f.references:
        about += f" ({f.references})"
    star = "" if f.default else " \\*"
    return f"| `{name}`{star} | {about} | {KINDS[f.rank]} | {unit} | {additive} | {average} |\n"


def _of_sums(f: Field) -> str:
    """How a sum is averaged."""
    return "about the averaged velocity" if takes_covariance(f, Options()) else "as they are"


def averages() -> str:
    """The table of averages in docs/evaluation.md."""
    rules: dict[str, list[str]] = {
        "as they are": ["other sums (*additive* in the [table](fields.md))"]
    }
    for name in listed(registered=False):
        f = FIELDS[name]
        if name.endswith("_error"):
            rule = "the larger of this noise and the scatter ([standard errors](width.md#standard-errors))"
        elif f.harmonic:
            rule = f"`{f.weight}` over the mean of `{f.weight}` divided by the field"
        elif f.weight:
            whose = ", that of the bulk" if f.by_bulk else ""
            rule = f"weighted by `{f.weight}`{whose}, over known values"
        elif f.additive:
            rule = _of_sums(f)
        else:
            rule = "computed anew from averages of the fields that they depend on, with the same variants"
        if rule != "as they are":
            rules.setdefault(rule, []).append(f"`{name}`")
    rows = [f"| {', '.join(fields)} | {rule} |\n" for rule, fields in rules.items()]
    return "".join(["| fields | how they are averaged |\n|---|---|\n", *rows])


def pages() -> dict[Path, str]:
    """All files that this writes, with their text."""
    found = {ROOT / "docs" / "fields.md": table()}
    path = ROOT / "docs" / "evaluation.md"
    before, rest = path.read_text().split(FIRST)
    found[path] = before + FIRST + averages() + "\n" + LAST + rest.split(LAST)[1]
    return found


if __name__ == "__main__":
    for path, text in pages().items():
        path.write_text(text)
