"""What `ds.cg` prints: what a scene holds, and what is missing."""

from __future__ import annotations

import xarray as xr


def summary(ds: xr.Dataset) -> str:
    """Tell what a Dataset holds of a scene, and what is missing."""
    if "position" not in ds:
        return "not a scene: no 'position' (fields are saved with .cg.to_vtkhdf, .to_netcdf, .to_zarr)"
    steps, particles, contacts = (ds.sizes.get(d, d == "time") for d in ("time", "particle", "contact"))
    lines = [f"scene of {int(steps)} steps with up to {particles} particles and {contacts} contacts"]
    for dim in ("particle", "contact"):
        names = [str(n) for n in ds.data_vars if dim in ds[n].dims]
        lines.append(f"  {dim + 's:':11s}{', '.join(names) or 'none'}")
    missing = [n for n in ("velocity", "diameter", "mass", "contact_force") if n not in ds]
    lines.append(f"  missing:   {', '.join(missing) or 'nothing'}")
    sizes = ", ".join(f"{k} = {ds.attrs[k]:.6g}" for k in ("dmin", "d50", "d43", "dmax") if k in ds.attrs)
    lines.append(f"  sizes:     {sizes or 'not measured'}")
    lines.append(f"  periodic:  {ds.attrs.get('periodic') or 'no axis'}; dimension {ds.attrs.get('dimension', 3)}")
    return "\n".join(lines)
