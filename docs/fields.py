"""Writes docs/fields.md, the table of all fields, from the registry: python docs/fields.py."""

import re
from pathlib import Path

from xcg.fields.registry import FIELDS, listed
from xcg.scene.schema import units_of

HEAD = """# Fields

What `ds.cg.coarse_grain([...])` takes by name. Psi is the kernel, the sums run over all grains (and their periodic
images) whose support reaches the node; [theory](theory.md) explains the formulas, [variants](variants.md) has other
definitions. Vectors have the dimension `component`; tensors have `component` (of the force or velocity) and `direction`
(of the face or derivative), so that `stress.sel(component="x", direction="z")` is sigma_xz. Compression is positive.
*Additive* fields of the phases add up to the bulk.

Sums are zero where nothing reaches. Ratios are NaN there, and `sample_count` says how many grains a node saw. A
velocity gradient is NaN along directions that the grains at a node do not span; a temperature is NaN where a linear
fit through the grains leaves less than half of a mean grain over (`fluctuation_density`, rho_T). Friction coefficient
and inertial number are NaN where p <= 0.

In a one-layer scene D = 2, and traces run over the two axes of the plane.

| field | what it is, and its formula | kind | unit | additive |
|---|---|---|---|---|
"""
TAIL = """
This table is made by `python docs/fields.py`; `xcg fields` prints it.
"""
KINDS = ("scalar", "vector", "tensor")
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def table() -> str:
    """The page, as text."""
    rows = []
    for name in listed():
        f = FIELDS[name]
        formula = f.formula.replace("|", "\\|")
        additive = "yes" if f.additive else ""
        unit = re.sub(r"(?<=[a-z])-?\d", lambda power: power[0].translate(RAISED), units_of(f.powers))
        rows.append(f"| `{name}` | {f.long_name}<br>`{formula}` | {KINDS[f.rank]} | {unit} | {additive} |\n")
    return HEAD + "".join(rows) + TAIL


if __name__ == "__main__":
    (Path(__file__).parent / "fields.md").write_text(table())
