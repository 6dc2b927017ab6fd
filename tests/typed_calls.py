"""Calls that mypy checks: what is right passes, and what is wrong is found (an unused ignore is an error)."""

import xarray as xr

from xcg import CoarseGrainAccessor, Mean, coarse_grain, open_scene, width_sweep


def use(ds: xr.Dataset) -> None:
    coarse_grain(ds, fields="density", width={1: 0.5, 2: "0.75 d43"}, at={"y": 0.0})
    width_sweep(ds, [1.0, 2.0, "1 d43"], at={"x": [0.0, 1.0]}, axes="z")
    path: xr.Dataset = CoarseGrainAccessor(ds).coarse_grain(["velocity"], kernel="lucy", rtol=1e-3)
    path.cg.save("velocity.nc")
    coarse_grain(ds, widht=1.0)  # type: ignore[call-arg]
    CoarseGrainAccessor(ds).coarse_grain(widht=1.0)  # type: ignore[call-arg]
    coarse_grain(ds, gradient="least squares")  # type: ignore[arg-type]
    coarse_grain(ds, deviatoric="none")  # type: ignore[arg-type]
    coarse_grain(ds, size="d10")  # type: ignore[arg-type]
    coarse_grain(ds, temperature="none")  # type: ignore[arg-type]
    coarse_grain(ds, preset="liggghts", per="grain")  # type: ignore[arg-type]
    CoarseGrainAccessor(ds).displacement(on_error="ignore")  # type: ignore[arg-type]
    CoarseGrainAccessor(ds).microstructure(rattlers="leave")  # type: ignore[arg-type]
    CoarseGrainAccessor(ds).adjacency(weight="mass")  # type: ignore[arg-type]
    CoarseGrainAccessor(ds).force_chains(algorithm="peters", min_stress="median")  # type: ignore[arg-type]
    CoarseGrainAccessor(ds).particle_stress(volume="sphere")  # type: ignore[arg-type]
    CoarseGrainAccessor(ds).slice_temperature(method="slices")  # type: ignore[arg-type]
    open_scene("particles.*", shape="disk", missing="leave")  # type: ignore[arg-type]
    Mean("density", weight="masses")  # type: ignore[arg-type]
    coarse_grain(ds, kernel="my own", gradient="paper", per="accessible", on_error="skip")
    CoarseGrainAccessor(ds).balance("density")  # type: ignore[call-arg]
    CoarseGrainAccessor(ds).force_chains(alpha="a")  # type: ignore[arg-type]
    path = CoarseGrainAccessor(ds).explain()  # type: ignore[assignment]
