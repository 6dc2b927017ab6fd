r"""
Voronoi cells: local packing
============================

Which part of the space belongs to which grain? The radical Voronoi cell of a sphere ends at the planes halfway
between the surfaces, roughly speaking, so the solid share of a cell is a packing fraction for each single grain. Its
mean must be the one that a smooth kernel finds.

225 spheres are sheared between two walls of frozen spheres. The script of the simulation (LAMMPS) is
:download:`plane_shear.in <../../../examples/data/lammps_plane_shear/plane_shear.in>`; the mean diameter is 1.
"""

import matplotlib.pyplot as plt
import numpy as np

import xcg

ds = xcg.datasets.open("plane_shear").compute()
cells = ds.cg.voronoi()
f = ds.cg.coarse_grain("volume_fraction", axes="z", width=1.0).cg.time_average()

z = ds.position.sel(component="z")
fraction = cells.voronoi_fraction.where(ds.frozen == 0)

fig, (left, right) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
left.plot(fraction.to_numpy().ravel(), z.to_numpy().ravel(), ".", ms=2, label="each grain")
left.plot(f.volume_fraction, f.z, "k-", label="kernel")
left.set(xlabel="packing fraction", ylabel="height $z$", ylim=(0, 11))
left.legend()
right.hist(cells.voronoi_neighbours.where(ds.frozen == 0).to_numpy().ravel(), np.arange(8.5, 22))
right.set(xlabel="neighbours of a cell", ylabel="grains", xticks=range(10, 22, 2))
plt.show()

# %%
# **Check.** Away from the walls the solid volume of all grains over the volume of all cells is the mean of the field:

middle = (z > 3) & (z < 8)
solid = float(ds.volume.where(middle).sum())
measured = solid / float(cells.voronoi_volume.where(middle).sum())
expected = float(f.volume_fraction.sel(z=slice(3, 8)).mean())
print(f"by cells {measured:.4f}, by the kernel {expected:.4f}")

filled = cells.voronoi_volume.sum("particle") / (6 * 4 * 11)
print(f"the cells fill the box to {float(abs(filled - 1).max()):.0e}")

# %%
# The rows of grains at the walls show in the single cells, and not in the field, which is smoothed over their distance.
# A cell has 14 neighbours in the mean: more than contacts, as neighbours need not touch.
#
# **For your own data, change** the line that opens them. Ends of a box that is open along an axis are its edges, or
# ``bounds={"z": (0.0, 0.2)}``; below a free surface the cells of the top layer reach up to them.
