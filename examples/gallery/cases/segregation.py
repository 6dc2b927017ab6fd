r"""
Segregation of two sizes
========================

In a flow small grains fall into gaps that large ones do not fit into. So the large ones come up, until the diffusion
that the same flow makes stirs as much back. Fields of each phase show how concentrations change, and how fast.

1100 small and 140 large spheres (:math:`d` = 1 and 2, as much of each by volume, :math:`m = g = 1`) start mixed and
flow down a rough plane of 25 degrees; the files hold grains alone, no contacts. The script of the simulation (LAMMPS)
is :download:`segregation.in <../../../examples/data/lammps_segregation/segregation.in>`.
"""

import matplotlib.pyplot as plt
import numpy as np
import pyvista

import xcg

ds = xcg.datasets.open("segregation").cg.assign_phases(
    edges=[1.5]
)  # 1: below, 2: above this diameter
names = ["volume_fraction", "density", "velocity", "concentration"]
f = ds.cg.coarse_grain(
    names, by="phase", axes="z", width=1.0, bounds={"z": (0, 24)}, spacing=0.25
).compute()
bulk = f.sel(phase="bulk")
large = f.sel(phase=2)
c = large.concentration.where(bulk.volume_fraction > 0.2)

# %%
# The grains at the start and at the end:

plotter = pyvista.Plotter(shape=(1, 2))
for k, step in enumerate((0, -1)):
    plotter.subplot(0, k)
    ds.cg.view("diameter", index=step, plotter=plotter)
    plotter.add_title(f"t = {float(ds.time[step]):.0f}", font_size=10)
plotter.show()

# %%
# The share of the large grains over time and height:

fig, ax = plt.subplots()
c.plot(
    x="time", ax=ax, vmin=0, vmax=1, cmap="RdYlBu", cbar_kwargs={"label": "share of large grains"}
)
ax.set(title="", xlabel=r"time [$\sqrt{d / g}$]", ylabel="height $z$", ylim=(0, 22))
plt.show()

# %%
# The flow sorts from both ends: first there are no small grains left at the surface and no large ones at the bottom,
# where it shears most.

fig, ax = plt.subplots()
for k, style in ((0, ":"), (4, "--"), (8, "-")):
    ax.plot(c.isel(time=k), c.z, f"C0{style}", label=f"t = {float(c.time[k]):.0f}")
ax.set(xlabel="share of large grains", ylabel="height $z$", xlim=(0, 1), ylim=(0, 22))
ax.legend()
plt.show()

# %%
# Two numbers say the same of each step: the height of the large grains' centre above that of the small ones, over its
# largest value, and Lacey's index in layers, which goes from 1 (mixed) towards 0.

m = ds.cg.microstructure(
    ["segregation_index", "lacey_index"], by="phase", cell={"z": 2.0}, mixing_weight="volume"
)
fig, ax = plt.subplots()
ax.plot(m.time, m.segregation_index.sel(phase="2"), "C3o-", label="centres: 0 mixed, 1 apart")
ax.plot(m.time, m.lacey_index.sel(phase="bulk"), "C0s-", label="Lacey in layers: 1 mixed, 0 apart")
ax.set(xlabel=r"time [$\sqrt{d / g}$]", ylabel="index", ylim=(-0.1, 1.1))
ax.legend(loc="center right")
plt.show()

# %%
# **Check.** Grains move and none is lost: the large ones' density, summed over height and area, is their mass.

area = 14 * 8
mass = float(area * large.density.isel(time=-1).integrate("z"))
expected = float(ds.mass.isel(time=-1).where(ds.phase.isel(time=-1) == 2).sum())
print(f"mass of the large grains: {mass:.2f} by the field, {expected:.2f} in the files")

# %%
# How fast do they rise? Schlick et al. (2015) found a flux :math:`S\,\dot\gamma\,\rho\,c\,(1 - c)` with :math:`S =
# 0.26\, d_s \ln (d_l / d_s)` in flows down heaps. Between two steps the large grains' mass, times the way that their
# centre rises above that of all grains, is the integral of the flux over height and time.


def centre(rho):
    return (rho * rho.z).integrate("z") / rho.integrate("z")


rise = large.density.integrate("z") * (centre(large.density) - centre(bulk.density))
rate = bulk.velocity.sel(component="x").differentiate("z").fillna(0)
share = large.concentration.fillna(0)
driven = (rate * bulk.density * share * (1 - share)).integrate("z").cumulative_integrate("time")
S = (rise.diff("time") / driven.diff("time")).values
print("S from step to step:", S.round(2), f"Schlick et al.: {0.26 * np.log(2):.2f}")

# %%
# In the first step, when the layer starts from rest and expands, it is higher. Then the grains part half as fast as in
# Schlick et al., whose flows are thin and near a surface; under pressure segregation is slower (Fry et al. 2018). Later
# the number falls, as diffusion stirs back what has parted: it is then no longer the flux of segregation alone.
#
# **For your own data, change** the line that opens them to ``xcg.open_scene("particles.*.dump")``, and ``edges``, or
# let ``ds.cg.find_phases()`` find how many sizes there are. ``"segregation_flux"`` is the flux itself, and with
# contacts ``"interphase_force"`` is what the phases do to each other, see :doc:`phases </phases>`.
