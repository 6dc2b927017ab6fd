"""Rows of fields: units are those of their formulas, and what the registry prints."""

import re

import numpy as np
import pytest

import xcg
from xcg.fields.formulas import registration, registry
from xcg.fields.formulas.field import Options
from xcg.fields.formulas.rows import displacement
from xcg.fields.formulas.rows.errors import OF_FITS


def test_the_registry_prints_topics_in_place_of_rows():
    shown = repr(xcg.FIELDS)
    counts = [int(number) for number in re.findall(r"[a-z] (\d+)", shown)]
    assert shown.startswith(f"{sum(counts)} fields (flow ")
    assert sum(counts) == len(registry.listed())
    assert "xcg.FIELDS['density']" in shown
    assert len(shown) < 250


@pytest.mark.parametrize("k", range(3), ids=["length", "mass", "time"])
@pytest.mark.parametrize("gradient", ["least_squares", "kernel", "paper"])
def test_all_formulas_have_the_dimensions_of_their_units(gradient, k):
    """Fields of moments in a unit half as large are larger by the power of that unit."""

    def fields_in(factor):
        options = Options(gradient=gradient, fluid_viscosity=factor ** (-1, 1, -1)[k], friction=0.4)
        names = registry.listed(registered=False)
        if gradient != "least_squares":
            names = [name for name in names if name not in OF_FITS]
        if k == 2:  # displacements stand in the place of velocities
            names = [name for name in names if name not in displacement.ROWS]
        fields = registry.fields_of(names, options).values()
        rows = registry.moments_of(fields, options)
        moments = registration._made_up(rows)
        scaled = {n: moments[n] * factor ** row.powers[..., k] for n, row in rows.items()}
        scaled["reference"] = moments["reference"] * factor ** (1.0, 0.0, -1.0)[k]
        return registry.evaluate(names, scaled, options)

    once = fields_in(1.0)
    for field, values in fields_in(2.0).items():
        expected = once[field] * 2.0 ** registry.FIELDS[field].powers[k]
        np.testing.assert_allclose(values, expected, rtol=1e-9, atol=1e-300, err_msg=field)
