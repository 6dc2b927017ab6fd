"""Writes docs/fields.md, the table of all fields, from the registry: python docs/fields.py."""

from pathlib import Path

from xcg.fields import FIELDS, listed
from xcg.schema import units_of

HEAD = """# Fields

One row a field, made from the registry by `python docs/fields.py`. Psi is the kernel, the sums run over all grains
(and their periodic images) whose support reaches the node. Vectors have the dimension `component`; tensors have
`component` (of the force or velocity) and `direction` (of the face or derivative), so that
`stress.sel(component="x", direction="z")` is sigma_xz. Compression is positive. *Additive* fields of the phases add up
to the bulk.

Sums are zero where nothing reaches. Ratios are NaN there, and `sample_count` says how many grains a node saw. A
velocity gradient is NaN along directions that the grains at a node do not span; a temperature is NaN where a linear
fit through the grains leaves nothing over. Friction coefficient and inertial number are NaN where p <= 0.

In a one-layer scene D = 2, and traces run over the two axes of the plane.

| field | kind | unit | additive | what it is | formula |
|---|---|---|---|---|---|
"""
KINDS = ("scalar", "vector", "tensor")


def table() -> str:
    """The page, as text."""
    rows = []
    for name in listed():
        f = FIELDS[name]
        formula = f.formula.replace("|", "\\|")
        additive = "yes" if f.additive else ""
        rows.append(f"| `{name}` | {KINDS[f.rank]} | {units_of(f.powers)} | {additive} | {f.long_name} | {formula} |\n")
    return HEAD + "".join(rows)


if __name__ == "__main__":
    (Path(__file__).parent / "fields.md").write_text(table())
