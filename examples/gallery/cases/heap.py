r"""
Slope of a deposit that ran out
===============================

How steep does a deposit lie? The deposit of a collapsed column, 1600 discs, with its free surface, where the volume
fraction is half of that inside, and the line that fits it best.

The script of the simulation (LAMMPS) is :download:`column.in <../../../examples/data/lammps_column/column.in>`, see the
`collapse of a column <../classics/column_collapse.html>`_; diameter and gravity are 1.
"""

import matplotlib.pyplot as plt
import numpy as np

import xcg

ds = xcg.datasets.open("column_2").isel(time=[-1])
f = ds.cg.coarse_grain("volume_fraction", axes="xy", width=1.5, spacing=0.5).compute()
surface = f.cg.free_surface("y", share=0.5).isel(time=0)

part = surface.sel(x=slice(20, 90))  # without the wall and the foot
fit = xcg.fit_slope(part)
angle = float(fit.angle)
error = float(fit.angle_error)
print(f"slope {angle:.2f} +- {error:.2f} degrees")

fig, ax = plt.subplots(figsize=(8, 3), layout="constrained")
f.isel(time=0)[["volume_fraction"]].cg.plot(ax=ax)
ax.plot(surface.x, surface.height, "r-", lw=1, label="free surface")
line = part.height.mean() + fit.slope.item() * (part.x - part.x.mean())
ax.plot(part.x, line, "w--", label=f"slope {angle:.1f} ± {error:.1f}°")
ax.set(xlim=(0, 150), ylim=(0, 32), xlabel="$x$", ylabel="$y$", aspect="equal")
ax.legend(loc="upper right", facecolor="0.6")
plt.show()

# %%
# **Check.** The tops of the highest grains in slices of 3 diameters lie on a line, too:

x, y = (ds.position.isel(time=0).sel(component=c).values for c in "xy")
edges = np.arange(20.0, 90.0, 3.0)
tops = [y[(a <= x) & (x < a + 3)].max() + 0.5 for a in edges]
of_grains = float(np.degrees(np.arctan(abs(np.polyfit(edges + 1.5, tops, 1)[0]))))
print(f"slope of the highest grains {of_grains:.2f} degrees")

# %%
# The error counts one independent place for each support of the kernel; the scatter about the line is the roughness of
# the surface. A deposit that ran out lies flatter than a heap that was poured, so this is not the angle of repose.
#
# **For your own data, change** the name of the sample to your files, and the part that is fitted. In three dimensions
# ``axes="xyz"`` and ``free_surface("z")`` give ``height`` over x and y, and ``fit_slope`` fits a plane.
