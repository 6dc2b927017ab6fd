r"""
Long series: stop, resume, average
==================================

A series of thousands of steps is larger than memory, and its fields may take hours, in which a machine can stop. xcg
reads, computes and writes step by step, and continues with the steps that are finished. Here 17 steps of spheres
between two rough walls that move at :math:`\pm 2.5` (:math:`d = m = 1`) stand for such a series. The script of the
simulation (LAMMPS) is :download:`plane_shear.in <../../../examples/data/lammps_plane_shear/plane_shear.in>`.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from dask.callbacks import Callback

import xcg

ds = xcg.datasets.open("plane_shear", chunks=1)  # reads headers alone; each step will be a task
f = ds.cg.coarse_grain(["density", "velocity", "stress"], axes="z", spacing=0.25)
target = Path(tempfile.mkdtemp()) / "fields.zarr"

# %%
# The first run stops on the way, as with Ctrl-C. Steps that it finished are in a hidden folder beside the target:


class Stop(Callback):
    """Stop a computation after some of its tasks."""

    def _posttask(self, key, result, dsk, state, worker_id):
        if len(state["finished"]) == 20:
            raise KeyboardInterrupt


try:
    with Stop():
        f.cg.save(target, resume=True)
except KeyboardInterrupt:
    print("stopped; there are", *sorted(path.name for path in target.parent.iterdir()))

# %%
# The same line again computes the steps that are missing, and names the folder as it should be:

f.cg.save(target, resume=True)
fields = xr.open_zarr(target)
print(dict(fields.sizes), *sorted(path.name for path in target.parent.iterdir()))

# %%
# The file is as large as the series. Its average is not: ``time_average`` reads a chunk at a time, and adds standard
# errors, which hold for steps that depend on those before them.

mean = fields.cg.time_average().compute()

fig, (ax, right) = plt.subplots(1, 2, sharey=True, layout="constrained")
V = mean.velocity.sel(component="x")
ax.errorbar(
    V,
    mean.z,
    xerr=2 * mean.velocity_error.sel(component="x"),
    fmt="o",
    ms=3,
    label="two standard errors",
)
ax.set(xlabel="velocity $V_x$ [$d/t$]", ylabel="height $z$", ylim=(None, 15))
ax.legend(loc="upper left")
shear, normal = (-mean.stress.sel(component=a, direction="z") for a in "xz")
right.plot(shear, mean.z, label=r"$-\sigma_{xz}$")
right.plot(-normal, mean.z, label=r"$\sigma_{zz}$")
right.set(xlabel="stress [$m / (d\\,t^2)$]")
right.legend()
plt.show()

# %%
# **Check.** The result is bit by bit that of a run without a stop, and the mean density holds the mass of the grains:

same = all(np.array_equal(fields[name], f[name], equal_nan=True) for name in f.data_vars)
area = np.prod(np.diff(ds.box[0, :2])[:, 0])
measured = area * float(mean.density.integrate("z"))
expected = float(ds.mass.where(ds.frozen == 0).sum("particle").mean())
print("same bits:", same)
print(f"mass in the mean density: {measured:.6f}, of the grains: {expected:.6f}")

# %%
# **For your own data, change** the line that opens them to ``xcg.open_scene("particles.*.dump", contacts=
# "contacts.*.dump")``. ``xcg run job.toml`` is the same in one command, and a ``distributed.Client`` spreads the steps
# over processes (:doc:`long series </scale>`: 28.8 GB, with a worker and then all processes killed).
