r"""
Hopper flow: Beverloo's law
===========================

Grains flow out of a silo at a rate that does not depend on how full it is, and that grows faster than the area of the
outlet. Beverloo et al. (1961) found the power 5/2 of the diameter for a round hole. For a slot of width :math:`D` and
length :math:`L` the rate is :math:`W = C \rho \sqrt g L (D - k d)^{3/2}`, with :math:`C = 1.03` (Myers & Sellers,
quoted by Nedderman, Tüzün, Savage & Houlsby, *Chem. Eng. Sci.* 37 (1982) 1597) and :math:`k` between 1 and 2. On their
way grains move apart.

1300 spheres flow through slots of 4, 5 and 6 diameters, and come back at the top. The script of the simulation (LAMMPS)
is :download:`hopper.in <../../../examples/data/lammps_hopper/hopper.in>`; diameter, mass and gravity are 1.
"""

import matplotlib.pyplot as plt
import numpy as np

import xcg

slots = np.array([4, 5, 6])
L = 4.0
runs = {D: xcg.datasets.open(f"hopper_{D}") for D in slots}

names = ["velocity", "volume_fraction", "velocity_gradient"]
inside = {"x": (0, 18), "z": (6, 24)}
f = runs[6].cg.coarse_grain(
    names, axes="xz", bounds=inside, width=1.0, spacing=0.5, for_averages=True
)
f = f.cg.time_average().compute()
v = f.velocity.where(f.volume_fraction > 0.1)

fig, ax = plt.subplots()
speed = (
    -v.sel(component="z")
    .drop_attrs(deep=False)
    .assign_attrs(long_name="downward velocity", units=r"$\sqrt{gd}$")
)
speed.to_dataset(name="speed").cg.plot(ax=ax, vmin=0, vmax=2)
ax.set(xlabel="$x$", ylabel="$z$", aspect="equal")
plt.show()

# %%
# The trace of the velocity gradient is the rate at which the volume grows, the dilation.

dilation = sum(f.velocity_gradient.sel(component=c, direction=c) for c in "xz").where(
    f.volume_fraction > 0.1
)

fig, ax = plt.subplots()
dilation = dilation.drop_attrs(deep=False).assign_attrs(
    long_name="rate of dilation", units=r"$\sqrt{g/d}$"
)
dilation.to_dataset(name="dilation").cg.plot(ax=ax, vmin=-0.4, vmax=0.4)
ax.set(xlabel="$x$", ylabel="$z$", aspect="equal")
plt.show()

# %%
# **Check.** In a steady flow the same mass goes through all heights, so that its rate is the momentum of all grains
# over the height of the box; `xcg.flow_rate` through the plane of the slot has it from the grains near the slot alone,
# with a larger error. With :math:`W^{2/3}` over :math:`D`, Beverloo's law is a straight line.

rate = []
error = []
density = []
outflow = []
for D, ds in runs.items():
    p = ds.cg.coarse_grain(["momentum_density", "density"], axes="z", width=1.0).compute()
    W = -p.momentum_density.sel(component="z").mean("z") * 18 * L
    rate.append(float(W.mean()))
    error.append(float(W.std() / np.sqrt(W.size - 1)))
    density.append(float(p.density.sel(z=slice(10, 16)).mean()))
    through = ds.cg.flow_rate(xcg.Plane((9, 0, 6), (0, 0, -1)), width=1.0).mass_flow_rate.compute()
    outflow.append((D, float(through.mean()), float(through.std() / np.sqrt(through.size - 1))))
slope, start = np.polyfit(slots, np.array(rate) ** (2 / 3), 1)
published = 1.03
C = slope**1.5 / (np.mean(density) * L)
k = -start / slope
print("rates", [f"{w:.1f} +- {e:.1f}" for w, e in zip(rate, error, strict=True)])
print(f"C = {C:.2f} (published {published}), k = {k:.2f} (1 to 2)")

fig, ax = plt.subplots()
D = np.linspace(2, 6.5, 50)
ax.errorbar(slots, rate, error, fmt="o", label="simulation")
ax.errorbar(*np.transpose(outflow), fmt="s", mfc="none", label="through the slot")
ax.plot(D, (slope * (D - k)).clip(0) ** 1.5, "k-", label=f"C = {C:.2f}, k = {k:.2f}")
ax.set(xlabel="width of the slot $D$", ylabel=r"rate [$m\sqrt{g/d}$]")
ax.legend()
plt.show()

# %%
# Both are near what is published, and the law is a straight line within the errors; three slots and five or six steps
# each leave some tenths in :math:`k`. The rate of dilation is largest above the edges of the slot; at the surface
# falling grains join the packing.
#
# **For your own data, change** ``runs`` to your files, and ``18 * L`` to the area over which the profile is averaged.
# Where grains do not come back, the rate is that of the first steps, before the silo is empty.
