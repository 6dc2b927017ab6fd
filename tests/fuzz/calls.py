"""Hostile calls: ``python -m tests.fuzz.calls --count 1000``.

Scenes and arguments of extreme magnitude, no extent, no rows or the wrong type. A call gives a result, or is refused in
the package's own words, within bounded time and memory. Run it with ``NUMBA_BOUNDSCHECK=1 XCG_JIT_CACHE=0``, so that an
index beyond its array is an error instead of a matter of luck.
"""

from __future__ import annotations

import argparse
import json
import random
import resource
import signal
import sys
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr

import xcg
from tests.fuzz.check import address_space, is_own

SECONDS = 20  # of the processor, for one call
EXTRA = 3 << 29  # bytes beyond what the process has after its first calls

Values = dict[str, Any]


def extreme(rng: random.Random, *, negative: bool = True) -> float:
    """Give a number of any magnitude."""
    value = rng.choice([
        10.0 ** rng.uniform(-300, 300), 10.0 ** rng.uniform(-20, 20), 10.0 ** rng.uniform(-4, 4),
        0.0, 5e-324, 1.7e308, 2.0**53, 2.0**53 + 2, 1 - 2.0**-53, 1e9, 1e12, float("nan"), float("inf"),
    ])  # fmt: skip
    return -value if negative and rng.random() < 0.3 else value


# --- scenes ----------------------------------------------------------------------------------------------


def _base(rng: random.Random) -> Values:
    """A small valid scene: random or on a lattice, whose grains lie where nodes and supports end."""
    numbers = np.random.default_rng(rng.randrange(2**32))
    count = rng.choice([1, 2, 3, 20, 300])
    position = numbers.uniform(0, 1, (count, 3))
    if rng.random() < 0.3:
        position = np.round(4 * position) / 4 + 1e-3 * np.arange(count)[:, None] * (
            rng.random() < 0.5
        )
    pairs = numbers.integers(0, count, (rng.choice([0, 1, 5, 400]), 2))
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    pairs[: len(pairs) // 4, 1] = -1
    point = position[pairs].mean(axis=1)
    return {
        "position": position, "velocity": numbers.normal(size=(count, 3)), "diameter": numbers.uniform(0.1, 0.3, count),
        "species": numbers.integers(0, 2, count), "contact_i": pairs[:, 0], "contact_j": pairs[:, 1],
        "contact_point": point, "contact_force": numbers.normal(size=(len(pairs), 3)), "density": 2500.0,
        "box": [[0.0, 1.0]] * 3, "periodic": rng.choice(["", "", "x", "z", "xy", "xyz"]),
    }  # fmt: skip


NUMBERS = ["position", "diameter", "contact_point", "contact_force", "velocity"]


def _one_entry(rng: random.Random, given: Values) -> None:
    name = rng.choice(NUMBERS)
    given[name] = np.array(given[name])
    if given[name].size:
        given[name].flat[rng.randrange(given[name].size)] = extreme(rng)


def _scaled(rng: random.Random, given: Values) -> None:
    factor = extreme(rng, negative=False)
    with np.errstate(all="ignore"):
        for name in rng.sample(NUMBERS, rng.choice([1, 3])):
            given[name] = np.multiply(given[name], factor)


def _box(rng: random.Random, given: Values) -> None:
    given["box"][rng.randrange(3)] = [0.0 if rng.random() < 0.5 else extreme(rng), extreme(rng)]


def _small_box(rng: random.Random, given: Values) -> None:
    given["box"], given["periodic"] = [[0.0, 10 ** rng.uniform(-4, 0)]] * 3, "xyz"


def _one_place(rng: random.Random, given: Values) -> None:
    given["position"] = given["position"] * 0.0 + 0.5


def _far(rng: random.Random, given: Values) -> None:
    given["position"] = given["position"] + np.eye(3)[rng.randrange(3)] * 10 ** rng.uniform(0, 20)


def _ids(rng: random.Random, given: Values) -> None:
    count = len(given["position"])
    given["particle_id"] = rng.choice([
        np.arange(count), np.arange(count)[::-1], np.zeros(count), np.arange(count) + 0.5, np.arange(count) * 2**40,
        np.arange(count, dtype=">i4"), np.arange(count, dtype="uint64"), np.arange(count) + 1e300, np.arange(count) - 1,
        np.arange(count).astype(str),
    ])  # fmt: skip


def _types(rng: random.Random, given: Values) -> None:
    name = rng.choice([name for name, values in given.items() if isinstance(values, np.ndarray)])
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        kind = rng.choice([">f8", ">i8", "<f4", "i1", "u8", "f2", "c16", "O", "U8", "?"])
        given[name] = given[name].astype(kind)


def _shape(rng: random.Random, given: Values) -> None:
    name = rng.choice([name for name, values in given.items() if isinstance(values, np.ndarray)])
    values = np.atleast_1d(given[name])
    given[name] = rng.choice(
        [values[:-1], values[..., None], values.T, values[:0], np.float64(0.0), list(values)]
    )


DAMAGES = [_one_entry, _one_entry, _scaled, _box, _small_box, _one_place, _far, _ids]
TYPES = [_types, _shape]


def scene(rng: random.Random) -> xr.Dataset:
    """Make a scene that may be damaged."""
    given = _base(rng)
    for _ in range(rng.choice([0, 1, 1, 2])):
        rng.choice(DAMAGES)(rng, given)
    if rng.random() < 0.15:  # last, as the others calculate with what is there
        rng.choice(TYPES)(rng, given)
    if rng.random() < 0.2:
        given = {name: value for name, value in given.items() if not name.startswith("contact")}
    ds = xcg.scene_from_arrays(**given)
    if rng.random() < 0.2:
        order = np.arange(ds.sizes["particle"])[:: rng.choice([-1, 2])]
        ds = ds.isel(particle=order)
    if rng.random() < 0.1:  # values that were changed after the scene was checked
        ds = ds.assign(position=ds.position * extreme(rng))
    return ds


# --- calls -----------------------------------------------------------------------------------------------


def _coarse_grain(rng: random.Random, ds: xr.Dataset) -> None:
    axes = rng.choice(["z", "z", "xz", "xyz", "", "x"])
    low, high = sorted(
        (rng.choice([0.0, 0.25, extreme(rng)]), rng.choice([1.0, 0.75, extreme(rng)]))
    )
    length = high - low if 0 < high - low < np.inf else 1.0
    options: Values = {
        "axes": axes, "spacing": rng.choice([0.25, length / 4, length / 4, extreme(rng)]),
        "width": rng.choice([0.2, 0.125, 0.5, length / 3, extreme(rng)]), "rtol": rng.choice([0.0, 0.0, 1e-3]),
        "gradient": rng.choice(["least_squares", "least_squares", "kernel", "finite_difference"]),
        "kernel": rng.choice(["lucy", "lucy", "gaussian", "heaviside"]),
    }  # fmt: skip
    if rng.random() < 0.7:
        options["bounds"] = dict.fromkeys(axes, (low, high))
    if "y" not in axes and rng.random() < 0.3:
        options["at"] = {"y": rng.choice([0.5, extreme(rng)])}
    if rng.random() < 0.2:
        options["by"] = "species"
    if rng.random() < 0.1:
        options["width"] = {0: extreme(rng), 1: 0.2}
        options["by"] = "species"
    fields = rng.choice(
        [None, "density", ["contact_stress"], ["stress", "granular_temperature", "fabric"]]
    )
    # as many nodes as a mesh may have would take minutes and all memory, which is what was asked for
    plan = ds.cg.explain(fields, **options)
    if np.prod(plan.nodes.shape) < 30_000:
        xcg.coarse_grain(ds, fields, **options)


def _find_contacts(rng: random.Random, ds: xr.Dataset) -> None:
    skin = rng.choice([0.0, 0.0, 0.01, extreme(rng)])
    found = xcg.find_contacts(ds, skin=skin, k_n=1e5, levels=rng.choice([None, 1, 5]))
    if found.sizes["contact"] < 5000:
        found.cg.coarse_grain(
            "contact_stress", axes="z", bounds={"z": (0.0, 1.0)}, spacing=0.25, width=0.2
        )


def _chains(rng: random.Random, ds: xr.Dataset) -> None:
    xcg.force_chains(ds).load()


def _others(rng: random.Random, ds: xr.Dataset) -> None:
    call = rng.choice([xcg.particle_stress, xcg.microstructure])
    call(ds).load()


CALLS: list[Callable[[random.Random, xr.Dataset], None]] = [
    _coarse_grain, _coarse_grain, _coarse_grain, _coarse_grain, _find_contacts, _chains, _others,
]  # fmt: skip


def outcome(seed: int) -> tuple[str, str]:
    """Make one call: "computed", "refused", or "failed" with what went wrong."""
    rng = random.Random(seed)
    try:
        rng.choice(CALLS)(rng, scene(rng))
    except (xcg.SceneError, ValueError) as error:
        return (
            ("refused", str(error)) if is_own(error) else ("failed", traceback.format_exc()[-2500:])
        )
    except Exception:
        return "failed", traceback.format_exc()[-2500:]
    return "computed", ""


def _hang(*_: object) -> None:
    msg = f"took more than {SECONDS} s"
    raise TimeoutError(msg)


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="number of the first call")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    np.seterr(all="ignore")
    signal.signal(signal.SIGPROF, _hang)
    counts: Counter[str] = Counter()
    for n, seed in enumerate(range(given.first, given.first + given.count)):
        if n == 50:  # compiled by now, most of it
            used = address_space()
            resource.setrlimit(resource.RLIMIT_AS, (used + EXTRA, used + EXTRA))
        print(seed, file=sys.stderr, flush=True)  # the last one is that which ended the interpreter
        signal.setitimer(signal.ITIMER_PROF, SECONDS if n >= 50 else 10 * SECONDS)
        result, detail = outcome(seed)
        signal.setitimer(signal.ITIMER_PROF, 0)
        counts[result] += 1
        if result == "failed":
            print(json.dumps({"seed": seed, "why": detail}), flush=True)
    print(json.dumps(counts))
    return counts["failed"] > 0


if __name__ == "__main__":
    sys.exit(main())
