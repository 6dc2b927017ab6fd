"""Loops run in Python: without the compiler, fields have the bits of compiled code."""

import os
import subprocess
import sys
import warnings

import numpy as np
import pytest

import xcg
from tests import ROOT

CALLS = {
    "default": {},
    "closed forms": {"rtol": 0.0, "gradient": "paper"},
    "in single precision": {
        "kernel": xcg.Lucy(width=0.6, dimension=1),
        "width": None,
        "axes": "z",
        "rtol": 1e-3,
    },
    "wider than the box": {"width": 0.9},
    "groups": {"by": "species", "by_pair": True, "axes": "xz", "rtol": 0.0},
    "slopes": {"gradient": "kernel", "axes": "z", "rtol": 0.0},
    "gaussian": {"kernel": "gaussian", "axes": "xy", "rtol": 0.0},
    "shifted": {"kernel": "shifted gaussian", "axes": "xy", "rtol": 0.0},
    "heaviside": {"kernel": "heaviside", "axes": "yz", "rtol": 0.0},
    "rotation": {
        "fields": [
            "couple_stress",
            "contact_energy_flux",
            "kinetic_heat_flux",
            "rotational_temperature",
        ]
    },
}


def all_fields():
    """Fields of a few grains by all loops, and contacts found from positions: arrays by name."""
    ds = xcg.datasets.random_scene(12, seed=3)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", xcg.SceneWarning)  # a mesh this coarse and grains this few
        results = {
            name: ds.cg.coarse_grain(**({"width": 0.6, "spacing": 0.8} | call))
            for name, call in CALLS.items()
        }
        found = ds.cg.find_contacts(skin=0.5)
    results["contacts"] = found[["contact_i", "contact_j", "contact_point"]]
    return {
        f"{name}, {field}": f[field].values for name, f in results.items() for field in f.data_vars
    }


@pytest.mark.slow  # test_references, with the loops in NumPy
def test_fields_in_python_have_the_bits_of_compiled_code(tmp_path):
    """Kernels of polynomials, roots, exp and erf; log and arcs come from the same library of C here and there."""
    path = tmp_path / "fields.npz"
    code = f"""
import numba, numpy as np
from tests.compiled.test_uncompiled import all_fields
from xcg.compiled.points import deposit
assert numba.config.DISABLE_JIT and not hasattr(deposit, "py_func")
np.savez({str(path)!r}, **all_fields())
"""
    env = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=env, cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-3000:]
    plain = np.load(path)
    compiled = all_fields()
    assert len(plain.files) == len(compiled) > 200
    for name, values in compiled.items():
        np.testing.assert_array_equal(plain[name], values, err_msg=name)
