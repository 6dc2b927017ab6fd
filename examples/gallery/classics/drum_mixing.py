r"""
Rotating drum: mixing
=====================

Grains in a drum turn with it as one body, until they come to the surface and flow down in a thin layer. There they mix:
Lacey's index goes from 0, where two sorts are apart, towards 1, where they are as mixed as by chance.

700 spheres fill a drum of radius 12 (in mean diameters) to a half, which makes two turns; those on the left and on the
right are species 1 and 2. The script of the simulation (LAMMPS) is :download:`mixing.in
<../../../examples/data/lammps_mixing/mixing.in>`.
"""

import matplotlib.pyplot as plt
import numpy as np

import xcg

ds = xcg.datasets.open("mixing_drum")
turns = ds.time * 0.05 / (2 * np.pi)  # angular velocity 0.05

f = ds.cg.coarse_grain("concentration", axes="xz", by="species", width=1.0, spacing=0.25).compute()
lacey = ds.cg.microstructure("lacey_index", by="species", cell=3.0).lacey_index.sel(phase="bulk")

fig, axes = plt.subplots(2, 2, sharex=True, sharey=True, figsize=(5.2, 5.6))
for ax, step in zip(axes.flat, (0, 1, 4, 8), strict=True):
    f.cg.plot("concentration", index=step, phase=2, ax=ax, cmap="coolwarm", vmin=0, vmax=1)
    ax.set_title(f"$N$ = {float(turns[step]):.2g}")
    (image,) = ax.images
    image.colorbar.remove()  # one bar for all
    ax.label_outer()
fig.colorbar(image, ax=axes, label="share of grains from the right half", location="bottom")
plt.show()

# %%
# Lacey's index compares how the share of a species differs from cell to cell, here of three grains' width, with that of
# a perfect order and of a random mixture. Where both halves come to lie as at first, after half a turn, it waits.

rate = np.polyfit(turns, -np.log(1 - lacey), 1)[0]

fig, ax = plt.subplots()
ax.plot(turns, lacey, "o", label="simulation")
ax.plot(turns, 1 - np.exp(-rate * turns), "k-", label=f"1 - exp(-$N$ / {1 / rate:.1f})")
ax.set(xlabel="turns $N$", ylabel="Lacey's index of mixing", ylim=(-0.05, 1))
ax.legend()
plt.show()

# %%
# **Check.** What flows down in the layer comes up below it: the momentum across any upright line is positive in one of
# them and negative in the other, and its sum is zero in a steady flow. Here is the mean over lines that are up to half
# a radius from the axis.

f = (
    ds.isel(time=slice(1, None))
    .cg.coarse_grain("momentum_density", axes="xz", width=1.0)
    .mean("time")
)
across = f.momentum_density.sel(component="x", x=slice(-6, 6)).compute()
down = float(across.clip(min=0).integrate("z").mean("x"))
up = -float(across.clip(max=0).integrate("z").mean("x"))
print(
    f"mass that flows down the layer {down:.2f}, and up below it {up:.2f}, in a unit of time and length of the drum"
)

# %%
# The difference is more than the scatter of eight steps: a drum this small flows in little avalanches, and a step every
# quarter of a turn meets more of the rising between them. After two turns the halves are on their way, not mixed: the
# index goes on to 1. It depends on the size of the cells, and a random mixture of few grains scatters about 1.
#
# **For your own data, change** ``by=`` to the variable that names the sorts (a type of the files, a size class of
# ``ds.cg.assign_phases``), and ``cell`` to the size of the sample that has to be mixed. More indices are in
# :doc:`microstructure </microstructure>`.
