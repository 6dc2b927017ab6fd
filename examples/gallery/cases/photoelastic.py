r"""
Photoelastic discs: from tables of an experiment
================================================

Tracking programs write tables of positions in pixels (trackpy), and photoelastic analysis writes tables of the forces
between discs (PeGS). This page has both for a packing that is known: 2400 discs of a :doc:`biaxial test
<../classics/shear_band>`, at the start and after 2 % of shortening. Its script (LAMMPS) is :download:`biaxial.in
<../../../examples/data/lammps_biaxial/biaxial.in>`. A camera of 25 pixels for each diameter sees the centres with an
error of a tenth of a pixel, and the forces have an error of 5 %. How much of that is left in the fields?
"""

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

import xcg

ds = xcg.datasets.open("biaxial").isel(time=[0, 1]).compute()
pixel = 1 / 25  # pixel in diameters
rng = np.random.default_rng(1)

seen = []
forces = []
for frame, step in enumerate(ds.time):
    now = ds.sel(time=step)
    r = now.position.values[:, :2]
    ids = now.particle_id.values
    noisy = r / pixel + rng.normal(scale=0.1, size=r.shape)
    seen.append(
        pd.DataFrame({"frame": frame, "particle": ids, "x": noisy[:, 0], "y": noisy[:, 1]}).assign(
            radius=now.diameter.values / 2 / pixel
        )
    )
    i, j = (now[name].values for name in ("contact_i", "contact_j"))
    there = i >= 0
    row = pd.Series(np.arange(ids.size), index=ids)
    i = i[there]
    j = j[there]
    force = now.contact_force.values[there, :2]
    branch = r[row[i]] - r[row[j]]
    box = np.ptp(now.box.values, axis=1)[:2]
    branch -= box * np.rint(branch / box)
    n = branch / np.linalg.norm(branch, axis=1)[:, None]
    across = np.stack([-n[:, 1], n[:, 0]], axis=1)  # z x n
    error = 1 + rng.normal(scale=0.05, size=(2, i.size))
    measured = (force * n).sum(axis=1) * error[0], (force * across).sum(axis=1) * error[1]
    forces.append(
        pd.DataFrame(
            {
                "frame": frame,
                "id1": i,
                "id2": j,
                "normal_force": measured[0],
                "tangential_force": measured[1],
            }
        )
    )
discs = pd.concat(seen)
contacts = pd.concat(forces)
print(
    discs.head(3).to_string(index=False),
    contacts.head(3).round(3).to_string(index=False),
    sep="\n\n",
)

# %%
# From here on nothing is known but the tables, the size of a pixel and the box. The unit of mass keeps that of forces,
# mass times length.

names = {"frame": "step", "particle": "particle_id"}
units = {"length": pixel, "mass": 1 / pixel}
layer = {"dimension": 2, "thickness": 1.0, "shape": "disc", "density": 1.0}
box = {"box": ds.box.values / pixel, "periodic": "xy"}
experiment = xcg.scene_from_table(
    discs, contacts=contacts, names=names, units=units, **box, **layer
)
print(experiment.cg)

# %%
# The pressure of the contacts, by the tables and by the simulation's own files, over the same nodes:

options = {"width": "1.5 d43", "spacing": 1.0, "bounds": {"x": (4, 36), "y": (8, 72)}}
found = experiment.cg.coarse_grain("contact_stress", **options).contact_stress.isel(time=1)
known = ds.cg.coarse_grain("contact_stress", **options).contact_stress.isel(time=1)


def pressure(stress):
    return (stress.sel(component="x", direction="x") + stress.sel(component="y", direction="y")) / 2


fig, axes = plt.subplots(1, 3, figsize=(10, 6), sharey=True, layout="constrained")
maps = {"by the tables": pressure(found), "by the simulation": pressure(known)}
for ax, (title, p) in zip(axes, maps.items(), strict=False):
    image = ax.pcolormesh(p.x, p.y, p.T, vmin=0, vmax=3)
    ax.set(title=title, xlabel="$x$", aspect="equal")
fig.colorbar(image, ax=axes[:2], label="pressure over the applied stress", extend="max")
difference = maps["by the tables"] - maps["by the simulation"]
image = axes[2].pcolormesh(
    difference.x, difference.y, difference.T, cmap="RdBu", vmin=-0.1, vmax=0.1
)
axes[2].set(title="difference", xlabel="$x$", aspect="equal")
fig.colorbar(image, ax=axes[2], label="difference of the pressure", extend="min")
axes[0].set(ylabel="$y$")
plt.show()

# %%
# **Check.** The error of single forces averages out over the contacts of a node, and that of positions nearly vanishes
# in the stress. Strains see the error of positions in full: a tenth of a pixel in both frames, over a few diameters.

scale = float(maps["by the simulation"].mean())
at_nodes, of_mean = (
    100 * float(x) / scale for x in ((difference**2).mean() ** 0.5, difference.mean())
)
print(f"error of the pressure: {at_nodes:.2f} % at a node, {of_mean:.2f} % of the mean")

wide = options | {"width": "2 d43"}
measured, true = (
    scene.cg.displacement("small_strain", **wide).small_strain.isel(time=0)
    for scene in (experiment, ds)
)
measured, true = (strain.sel(component="y", direction="y") for strain in (measured, true))
noise = float(((measured - true) ** 2).mean() ** 0.5)
print(
    f"axial strain: {float(true.mean()):.4f} by the simulation, {float(measured.mean()):.4f} by the tables"
)
stress = float(maps["by the tables"].mean())
expected = scale
print(f"error of the strain at a node: {noise:.4f}")

# %%
# **For your own data, change** the two tables to those of your programs, for example ``trackpy.link(...)`` and the
# adjacency list of PeGS, ``pixel``, and ``box``, which a cell with walls does not need. Rows that name a wall are
# dropped, as these lists hold no direction for them. More: :doc:`tables </other_codes>`.
