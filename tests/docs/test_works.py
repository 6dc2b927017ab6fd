"""Claims of docs/works.md beside those of the papers, on the scripts' own scenes."""

import runpy

import numpy as np
import pytest

from tests import ROOT


def test_an_erodible_bed_speeds_up_from_above_and_heats_up_from_below():
    script = runpy.run_path(str(ROOT / "examples" / "erodible_bed.py"))
    ds = script["open_bed"]()
    f = script["profiles"](ds)
    # mass of a step, by the profile and by the grains, but for the one above the mesh
    area = np.prod(np.diff(ds.box[0, :2])[:, 0])
    loose = ds.where(ds.frozen == 0)
    on_mesh = loose.mass.where(loose.position.sel(component="z") < 17).sum("particle")
    assert area * f.density.integrate("z").values == pytest.approx(on_mesh.values, rel=2e-3)
    first, last = (
        script["temperatures"](ds, f, steps) for steps in (slice(None, 9), slice(-9, None))
    )
    dense = {"z": np.arange(2.0, 11.5)}
    for name, other in last.items():
        share = other.interp(dense) / last["kernel"].interp(dense)
        assert share.values == pytest.approx(1.0, abs=0.1), name
    assert last["kernel"].interp(z=2.0) > 4 * last["kernel"].interp(z=11.0)
    assert first["kernel"].interp(z=11.0) > 2 * first["kernel"].interp(z=2.0)
    speed = f.velocity.sel(component="x").interp(z=8.0)
    assert speed[-9:].mean() > 2 * speed[:9].mean()
