r"""
Void fraction on fluid cells
============================

A coupled code (CFD-DEM) needs the void fraction :math:`\varepsilon = 1 - \phi` on the cells of the fluid's mesh.
``cell_volumes`` shares the volume of each sphere among the cells that it overlaps, so that the cells hold all of the
solid volume, whatever their size: that is what a solver of the balance of mass needs.

The grains come from the :doc:`silo <silo_pressure>`: 3800 spheres in a cylinder of 50 mm (:download:`silo.in
<../../../examples/data/lammps_silo/silo.in>`, LAMMPS), in a mesh of cells of 10 mm, two grains wide.
"""

import matplotlib.pyplot as plt
import numpy as np

import xcg

ds = xcg.datasets.open("silo")
edges = {
    "x": (-0.04, 0.04),
    "y": (-0.04, 0.04),
    "z": (-0.02, 0.26),
}  # centres of the first and last cells
f = ds.cg.cell_volumes(0.01, bounds=edges).isel(time=0).compute()

fig, ax = plt.subplots()
cells = f.void_fraction.sel(y=0.0, method="nearest")
image = ax.pcolormesh(1e3 * f.z, 1e3 * f.x, cells.T.transpose("x", "z"), vmin=0.35, vmax=1)
fig.colorbar(image, label=r"void fraction $\varepsilon$", location="top")
ax.set(xlabel="$z$ [mm]", ylabel="$x$ [mm]", aspect="equal")
plt.show()

# %%
# **Check.** The sum of :math:`1 - \varepsilon` over the cells times the volume of a cell is the volume of the grains.
# Fields at the centres of the cells, which are what most programs take, hold it only where cells are small against the
# grains.

solid = float(ds.volume.sum())
found = float(f.volume_fraction.sum()) * 0.01**3
print(f"volume of the grains {1e6 * solid:.4f} cm3, of the cells' solid {1e6 * found:.4f} cm3")


def lost(fields, size):
    """Error of the solid volume in cells of one size."""
    return abs(float(fields.volume_fraction.sum()) * size**3 / solid - 1)


sizes = np.array([0.005, 0.01, 0.02])
exact = [lost(ds.cg.cell_volumes(h, bounds=edges), h) for h in sizes]
smoothing = {"width": "1.5 d43", "bounds": edges}
at_centres = [lost(ds.cg.coarse_grain("volume_fraction", spacing=h, **smoothing), h) for h in sizes]

fig, ax = plt.subplots()
ax.loglog(1e3 * sizes, at_centres, "o-", label="values at the centres")
ax.loglog(1e3 * sizes, exact, "s-", label="cell_volumes")
ax.set(
    xlabel="size of a cell [mm]",
    ylabel="relative error of the solid volume",
    ylim=(1e-17, 1),
    xticks=1e3 * sizes,
)
ax.set_xticklabels(["5", "10", "20"])
ax.minorticks_off()
ax.legend()
plt.show()

# %%
# **For your own data, change** ``edges`` and the spacing to your mesh's: ``edges`` are the *centres* of the outermost
# cells. For cells of other shapes, ``at=xcg.mesh_points("mesh.vtu", centers=True)`` takes the centres of a mesh from
# its file. Drag and slip velocity come the same way: :doc:`void fraction and drag </cfd_dem>`.
