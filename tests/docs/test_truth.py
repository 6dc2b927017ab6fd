"""The table of truths: fast parts of it, and that its warnings are due."""

from dataclasses import replace
from unittest import mock

import pytest

from docs import truth
from tests.truths import systems

FLOORED = ("friction_coefficient", "inertial_number", "shear_rate", "anisotropy", "order", "angle")


def rows_of(name, mesh, *widths):
    (system,) = systems([name])
    return list(truth.measure(system, [mesh], widths))


@pytest.fixture(scope="module")
def rows():
    """Rows of some systems: profiles, and a volume at a wide width; their uncertainties are not used."""
    with mock.patch.object(truth, "GROUPS", 2):
        return _rows()


def _rows():
    return [
        *rows_of("elastic gas", "profile", 1.0),
        *rows_of("uniform shear", "profile", 1.0),
        *rows_of("contacts", "profile", 1.0),
        *rows_of("rods", "volume", 0.75),
        *rows_of("rigid rotation", "volume", 1.5),
        *rows_of("static column", "profile", 1.0),
        *rows_of("Couette flow", "profile", 0.75),
        *rows_of("inclined column", "profile", 1.0),
        *rows_of("segregating mixture", "profile", 1.0),
        *rows_of("turned contacts", "profile", 1.0),
    ]


def test_sums_and_their_ratios_are_true(rows):
    names = (
        "volume_fraction",
        "pressure",
        "granular_temperature",
        "contact_stress",
        "vorticity",
        "segregation_flux",
        "sliding_share",
        "friction_mobilisation",
        "first_normal_stress_difference",
        "second_normal_stress_difference",
    )
    checked = [row for row in rows if row.truth.name in names]
    assert len(checked) > 15
    for row in checked:
        assert abs(row.error) < truth.CLOSE, row


def test_averages_less_their_bias_are_within_two_errors(rows):
    averages = [row for row in rows if row.way == "average" and row.unbiased == row.unbiased]
    checked = [row for row in averages if row.truth.part != "xx"]  # which holds part of the shear
    assert len(checked) >= 8
    for row in checked:
        assert abs(row.unbiased - row.value) < 0.5
        if row.truth.scale is None:  # a norm whose truth is zero is never less
            assert row.within > 0.75, row


def test_values_of_single_steps_far_from_the_truth_are_warned_of(rows):
    for row in rows:
        is_floored = any(name in row.truth.name for name in FLOORED)
        if row.way == "one step" and is_floored and abs(row.error) > 0.25:
            assert row.said == "warning", row


def test_fields_without_a_floor_are_silent(rows):
    # about the node's velocity they hold part of a rotation and of a shear, and are warned of
    warned = (*FLOORED, "fluctuating_kinetic_energy", "kinetic_stress")
    silent = [row for row in rows if not any(name in row.truth.name for name in warned)]
    assert {row.said for row in silent} == {""}


def test_a_stress_that_holds_the_variation_of_the_flow_is_warned_of(rows):
    for row in rows:
        if row.truth.name == "kinetic_stress" and row.way == "one step":
            holds = row.system == "uniform shear"
            assert (row.said == "warning") == holds, row
            assert (row.truth.part == "xx" and row.error > truth.CLOSE) <= holds


def test_uncertainties_are_the_scatter_of_the_steps():
    """Of a mean over nodes and steps: that of eight pairs of steps over the square root of their number."""
    (system,) = systems(["elastic gas"])
    ds = system.make()
    truths = [about for about in system.truths if about.name == "volume_fraction"]
    of_volume = replace(system, make=lambda: ds, truths=truths)
    row, _ = truth.measure(of_volume, ["plane"], [1.0])  # of one step, and of the average
    f = ds.cg.coarse_grain("volume_fraction", width="1 d43", **system.nodes("plane"))
    pairs = f.volume_fraction.mean(["x", "z"]).to_numpy().reshape(2, 8).mean(axis=0)
    scatter = pairs.std(ddof=1) / 8**0.5 / row.truth.value
    assert row.uncertainty == pytest.approx(scatter, rel=1e-6)
    assert row.excess == max(abs(row.value - 1) - 2 * row.uncertainty, 0)


def test_ranges_of_widths():
    def run(*deviations):
        (system,) = systems(["rods"])
        (about,) = system.truths
        return truth._from_width(
            [
                truth.Row("", about, "volume", width, "one step", 1 + d, float("nan"), 0.0, 1.0, "")
                for width, d in zip(truth.WIDTHS, deviations, strict=True)
            ]
        )

    assert run(0, 0, 0, 0, 0, 0) == "all"
    assert run(1, 1, 1, 1, 1, 1) == "none"
    assert run(1, 0, 1, 0, 0, 0) == "from 1.5"
    assert run(0, 0, 0, 1, 1, 1) == "to 1"
    assert run(1, 0, 0, 1, 1, 1) == "0.75 to 1"
