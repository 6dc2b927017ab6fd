"""Calls that mypy checks: what is right passes, and what is wrong is found (an unused ignore is an error)."""

import xarray as xr

from xcg import CoarseGrainAccessor, coarse_grain, width_sweep


def use(ds: xr.Dataset) -> None:
    coarse_grain(ds, fields="density", width={1: 0.5, 2: "0.75 d43"}, at={"y": 0.0})
    width_sweep(ds, [1.0, 2.0, "1 d43"], at={"x": [0.0, 1.0]}, axes="z")
    path: xr.Dataset = CoarseGrainAccessor(ds).coarse_grain(["velocity"], kernel="lucy", rtol=1e-3)
    path.cg.save("velocity.nc")
    coarse_grain(ds, widht=1.0)  # type: ignore[call-arg]
    CoarseGrainAccessor(ds).coarse_grain(widht=1.0)  # type: ignore[call-arg]
    CoarseGrainAccessor(ds).balance("density")  # type: ignore[call-arg]
    CoarseGrainAccessor(ds).force_chains(alpha="a")  # type: ignore[arg-type]
    path = CoarseGrainAccessor(ds).explain()  # type: ignore[assignment]
