r"""
Impact of a sphere
==================

A sphere that hits a bed of grains is slowed down by what it sets in motion, and later by the weight and friction of the
grains that it pushes aside. Fields show how far into the bed it is felt.

A sphere of 10 mm falls with 1 m/s on 2200 grains of 2.25 to 2.75 mm; these are the first four milliseconds. The script
of the simulation (LAMMPS) is :download:`impact.in <../../../examples/data/lammps_impact/impact.in>`.
"""

import matplotlib.pyplot as plt

import xcg

ds = xcg.datasets.open("impact")  # species 1 are the grains, 2 is the sphere
ring = {
    "axes": "rz",
    "frame": xcg.Cylindrical(),
    "bounds": {"r": (0, 0.016), "z": (0, 0.032)},
    "spacing": 0.0005,
}
f = (
    ds.isel(time=0)
    .cg.coarse_grain(["pressure", "velocity"], by="species", width=0.002, **ring)
    .compute()
)

# %%
# An average over the angle about the axis of the fall, of the grains alone, after 1 ms. The line is the sphere.

sphere = ds.isel(particle=-1).compute()
fig, ax = plt.subplots()
f.sel(phase=1).cg.plot("pressure", ax=ax, arrows=None)
ax.add_patch(plt.Circle((0, float(sphere.position[0, 2])), 0.005, fill=False, lw=2))
ax.set(
    title="1 ms after the start",
    xlim=(0, 0.016),
    ylim=(0, 0.032),
    xlabel="radius $r$ [m]",
    ylabel="height $z$ [m]",
)
plt.show()

# %%
# Forces spread out below it along :doc:`chains </chains>`, here those of four grains or more whose stress is above the
# mean:

first = ds.isel(time=[0])
chains = first.cg.force_chains(min_stress="mean", min_length=4)
first.cg.view(chains=chains)

# %%
# The pressure below the sphere is tens of times that of the bed at rest, and spreads at once through all of the bed, as
# it is only two of the sphere's diameters deep.
#
# **Check.** The force of the grains on the sphere is ``interphase_force``, summed over all space. It is the sphere's
# mass times its acceleration, less its weight: the file has its total force for each step.

names = ["interphase_force"]
p = ds.cg.coarse_grain(names, by="species", axes="z", width=0.002, spacing=0.0005).compute()
area = 0.035**2  # of the box, which is periodic
on_sphere = area * p.interphase_force.sel(phase=2, other_phase=1, component="z").integrate("z")
weight = sphere.mass * ds.attrs["gravity"][2]
in_file = sphere.force_z - weight
for k in range(4):
    print(f"{k + 1} ms: {on_sphere[k]:.4f} N by the field, {in_file[k]:.4f} N in the files")
contact = on_sphere[0]
expected = in_file[0]

# %%
# They differ by some tenths of a per cent, as LAMMPS writes forces of contacts that are half a time step off where
# grains collide. A sphere in so coarse a bed hits single grains, so that the force goes up and down. After 60 ms it
# nearly rested, 4.6 mm below the place of the first touch (``sphere.txt``); the law of Uehara et al. (2003), for beds
# that are deeper and finer, says 7 to 8 mm.
#
# **For your own data, change** the line that opens them to ``xcg.open_scene("particles.*.dump",
# contacts="contacts.*.dump", walls={"floor": "f_floor[*]"}, gravity=...)``, and the frame,
# ``xcg.Cylindrical(origin=...)``. More on axes of that kind: :doc:`cylinders and rotated axes </frames>`.
