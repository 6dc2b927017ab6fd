r"""
Column collapse: run-out
========================

A column of grains that is set free spreads by a distance that depends on its aspect ratio :math:`a` alone, height over
width: its run-out over its width grows like :math:`a` for low columns and about like :math:`a^{2/3}` for tall ones
(Lajeunesse et al. 2005, Lube et al. 2005). With rods, which are discs, it is :math:`3.25\,a^{0.96}` below 1.5 and
:math:`3.80\,a^{0.73}` above (arXiv:1512.05180).

1600 discs stand between a wall and a gate on a rough base, and the gate is taken away, for five aspect ratios. The
script of the simulation (LAMMPS) is :download:`column.in <../../../examples/data/lammps_column/column.in>`; diameter
and gravity are 1.
"""

import matplotlib.pyplot as plt
import numpy as np

import xcg


def height(ds):
    """Height of the packing over x: the area of grains, over that share of a dense packing."""
    options = {"axes": "x", "extent": {"y": 1.0}, "width": 2.0, "spacing": 0.5}
    column = ds.cg.coarse_grain("volume_fraction", **options).volume_fraction.compute()
    return (column / 0.82).drop_attrs(deep=False).assign_attrs(long_name="height of the packing")


ds = xcg.datasets.open("column_2")
h = height(ds)

fig, ax = plt.subplots()
for step, shade in zip((0, 2, 3, 8), np.linspace(0.7, 0, 4), strict=True):
    ax.plot(h.x, h.isel(time=step), color=str(shade), label=f"{float(ds.time[step]):.0f}")
ax.set(xlabel="$x$", ylabel="height", xlim=(0, 160), ylim=0)
ax.legend(title=r"time [$\sqrt{d/g}$]")
plt.show()

# %%
# The free surface, where the volume fraction falls through half of its bulk value, has no need of a dense packing. With
# the integrals over the depth it makes what models of avalanches take: the depth-averaged velocity, and its shape
# factor, which is 1 for a block and 5/4 for Bagnold's profile.

f = ds.cg.coarse_grain("volume_fraction", axes="xy", width=1.5, spacing=0.5)
surface = f.cg.free_surface("y").compute()
depth = ds.cg.depth_average("y", axes="x", width=2.0).compute()
u, alpha = (depth[name].sel(component="x") for name in ("depth_averaged_velocity", "shape_factor"))

fig, axes = plt.subplots(3, 1, sharex=True, layout="constrained", figsize=(6.4, 6.4))
for step, shade in zip((1, 2, 3), (0.6, 0.3, 0), strict=True):
    label = f"{float(ds.time[step]):.0f}"
    thick = depth.solid_depth.isel(time=step) > 1
    axes[0].plot(surface.x, surface.height.isel(time=step), color=str(shade), label=label)
    axes[1].plot(u.x, u.isel(time=step).where(thick), color=str(shade))
    axes[2].plot(
        u.x, alpha.isel(time=step).where(thick & (u.isel(time=step) > 0.5)), color=str(shade)
    )
axes[0].set(ylabel="surface $h$", ylim=0)
axes[1].set(ylabel=r"velocity [$\sqrt{gd}$]")
axes[2].set(ylabel=r"shape factor $\alpha$", xlabel="$x$", xlim=(0, 160), ylim=(0.95, 1.6))
axes[0].legend(title=r"time [$\sqrt{d/g}$]")
plt.show()

# %%
# The front is where the height falls below one diameter. The run-out is how far it went, over the width of the column.

aspects = np.array([0.5, 1, 2, 4, 8])
runout = []
for a in aspects:
    h = height(xcg.datasets.open(f"column_{a:g}"))
    before, after = (float(h.x.where(h.isel(time=step) > 1).max()) for step in (0, -1))
    runout.append((after - before) / before)
low = np.polyfit(np.log(aspects[:3]), np.log(runout[:3]), 1)
tall = np.polyfit(np.log(aspects[2:]), np.log(runout[2:]), 1)

fig, ax = plt.subplots()
ax.loglog(aspects, runout, "o", label="simulation")
for (power, start), some in ((low, aspects[:3]), (tall, aspects[2:])):
    ax.loglog(
        some, np.exp(start) * some**power, "-", label=f"{np.exp(start):.1f} $a^{{{power:.2f}}}$"
    )
ax.set(
    xlabel="aspect ratio $a$",
    ylabel="run-out / width",
    xticks=aspects,
    xticklabels=["0.5", "1", "2", "4", "8"],
)
ax.minorticks_off()
ax.legend()
plt.show()

# %%
# **Check.** The powers of low and of tall columns:

exponent = float(tall[0])
expected = 0.73
print("run-out over width", np.round(runout, 2))
print(
    f"power of low columns {low[0]:.2f} (published 0.96 to 1), of tall ones {exponent:.2f} (2/3 to {expected})"
)

# %%
# The power of tall columns is the published one, that of low ones, from three runs, is 6 % above it. The factor depends
# on the grains and on what they run over: it is 1.2 in channels of sand (Lube et al.) and 3.25 for the rods on a plane.
# The tallest columns are 14 to 20 grains wide, so that their run-out depends on that as well.
#
# **For your own data, change** the names of the files, and the height at which the front is (here 1 diameter). A
# surface in three dimensions comes from ``axes="xy"`` with ``extent={"z": 1.0}`` in the same way.
