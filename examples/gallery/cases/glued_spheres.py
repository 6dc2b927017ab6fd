r"""
Clumps of glued spheres
=======================

Codes make grains of other shapes by gluing spheres together. What holds a body together is no contact, so a stress that
is summed over spheres misses it. Summed over bodies, from each contact to the centre of the body, it is complete.

400 rods of three spheres (:math:`d = m = 1`) rest on a rough floor that is tilted by 15 degrees, so that the stress is
known: the weight of the rods above. The script of the simulation (LAMMPS) is :download:`glued.in
<../../../examples/data/lammps_glued/glued.in>`.
"""

import matplotlib.pyplot as plt

import xcg

ds = xcg.datasets.open("glued")  # body_id says which rod a sphere belongs to
options = {"axes": "z", "width": 1.0, "bounds": {"z": (0, 16)}, "spacing": 0.25}
names = ["density", "contact_stress", "coordination_number"]
spheres = ds.cg.coarse_grain(names, **options).isel(time=0).compute()
bodies = ds.cg.coarse_grain(names, by_body="body_id", **options).isel(time=0).compute()

# %%
# At rest :math:`\sigma_{zz}` is the weight of the column above, and :math:`-\sigma_{xz}` its part along the floor.


def weight_above(f, axis):
    weight = f.density * ds.attrs["gravity"]["xyz".index(axis)]
    return abs(weight.integrate("z") - weight.cumulative_integrate("z"))


fig, ax = plt.subplots()
for f, mark, label in ((spheres, "x", "summed over spheres"), (bodies, "o", "summed over bodies")):
    stress = f.contact_stress.sel(direction="z")
    ax.plot(stress.sel(component="z"), f.z, f"C0{mark}", ms=4, label=rf"$\sigma_{{zz}}$, {label}")
    ax.plot(-stress.sel(component="x"), f.z, f"C1{mark}", ms=4, label=rf"$-\sigma_{{xz}}$, {label}")
ax.plot(weight_above(bodies, "z"), bodies.z, "k-", lw=1, label="weight above")
ax.plot(weight_above(bodies, "x"), bodies.z, "k-", lw=1)
ax.set(xlabel="stress [$m g / d^2$]", ylabel="height $z$")
ax.legend(fontsize=10)
plt.show()

# %%
# **Check.** Means between the floor and the surface:

inner = {"z": slice(2, 11)}
for axis in "zx":
    for f, what in ((spheres, "spheres"), (bodies, "bodies")):
        carried = float(abs(f.contact_stress.sel(component=axis, direction="z").sel(inner)).mean())
        load = float(weight_above(f, axis).sel(inner).mean())
        print(
            f"sigma_{axis}z by {what}: {carried:.3f}, weight {load:.3f}, ratio {carried / load:.4f}"
        )

# %%
# A sum over spheres misses a part of the stress, and friction is off with it. Bodies leave less than a tenth of a per
# cent: the rods still move a little. Contacts of a rod are counted for all of it, too:

print(f"contacts of a rod:    {float(bodies.coordination_number.sel(z=6)):.2f}")
print(f"contacts of a sphere: {float(spheres.coordination_number.sel(z=6)):.2f}")

# %%
# **For your own data, change** the line that opens them to ``xcg.open_scene("particles.*.dump",
# contacts="contacts.*.dump", walls={"floor": "f_floor[*]"})``; a column other than LAMMPS' ``mol`` that numbers your
# bodies is named by ``names={"clump": "body_id"}``. :doc:`Phases </phases>` describes how bodies are made;
# ``ds.cg.group_bodies("body_id")`` gives them as a scene.
