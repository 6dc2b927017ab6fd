r"""
Silo pressure: Janssen's law
============================

The side of a silo carries most of what is in it, so that the pressure stops growing with depth (Janssen 1895). A layer
in a cylinder of radius :math:`R` pushes against the side with the pressure :math:`K \sigma_{zz}`, and the side holds it
by the share :math:`\mu_w` of that. The forces on a layer of thickness :math:`dh` balance if :math:`\pi R^2 d\sigma_{zz}
= \pi R^2 \rho g\, dh - 2 \pi R\, \mu_w K \sigma_{zz}\, dh`, with :math:`\rho` the density. So :math:`\sigma_{zz} = \rho
g \ell\,(1 - e^{-h/\ell})` at the depth :math:`h`, with :math:`\ell = R / 2 K \mu_w`.

3800 spheres fill a cylinder to 4.6 times its diameter, and its floor went down a little, so that they slid along the
side. The script of the simulation (LAMMPS) is :download:`silo.in <../../../examples/data/lammps_silo/silo.in>`.
"""

import matplotlib.pyplot as plt
import numpy as np

import xcg

ds = xcg.datasets.open("silo")  # contacts with the "side" and the "floor"
side = xcg.Cylinder((0, 0, 0), (0, 0, 1), radius=0.025, low=0.0, high=0.24)
floor = xcg.Plane((0, 0, 0), (0, 0, 1))

wall = ds.cg.wall_stress(side, "1 d43", walls="side").isel(time=0).mean("theta")
bottom = ds.cg.wall_stress(floor, "1 d43", walls="floor").isel(time=0)
names = ["density", "stress"]
inside = {"surfaces": [side, floor], "per": "accessible", "spacing": 2.5e-3}
f = ds.cg.coarse_grain(names, axes="z", width="1 d43", **inside)
f = f.isel(time=0).compute()

# %%
# The forces of the lowest 60 mm. A tube leads from each grain to its contact, thicker and brighter the larger the force
# is; at the side, tubes end at the wall, and strong ones lead up from it:

low = ds.isel(particle=(ds.position.isel(time=0).sel(component="z") < 0.06).values)
low.cg.view(contacts=True)

# %%
# Nothing is fitted: the density, the pressure ratio :math:`K` and the friction that the side really takes (not the most
# that it could) are those of the fields, over the heights that are far from both ends.

z_top, g = 0.23, 9.81
middle = slice(0.05, 0.18)
sigma_zz = f.stress.sel(component="z", direction="z")
push = wall.normal_traction.sel(z=middle).mean()
K = float(push / sigma_zz.sel(z=middle).mean())
mu_w = float(-wall.shear_traction.sel(along="z", z=middle).mean() / push)
rho = float(f.density.sel(z=middle).mean())
length = 0.025 / (2 * K * mu_w)
janssen = rho * g * length * (1 - np.exp(-(z_top - f.z) / length))

fig, ax = plt.subplots()
ax.plot(sigma_zz / 1e3, f.z * 1e3, label=r"$\sigma_{zz}$ of the grains")
ax.plot(wall.normal_traction / 1e3, wall.z * 1e3, label="pressure on the side")
ax.plot(janssen / 1e3, f.z * 1e3, "k--", label="Janssen")
ax.plot(rho * g * (z_top - f.z) / 1e3, f.z * 1e3, "k:", label="weight above")
ax.set(xlabel="stress [kPa]", ylabel="$z$ [mm]", xlim=(0, 3.5), ylim=(0, 245))
ax.legend()
plt.show()

# %%
# **Check.** The law has the right size where nothing but the ratio of forces on the side went into it:

deep = slice(0.05, 0.23)
measured = float(sigma_zz.sel(z=deep).mean())
expected = float(janssen.sel(z=deep).mean())
print(f"K = {K:.2f}, friction of the side {mu_w:.2f}, length {1e3 * length:.0f} mm")
print(f"mean vertical stress above 50 mm: {measured:.0f} Pa, by Janssen's law {expected:.0f} Pa")

weight = g * float(ds.mass.sum())
held = [-float(s.wall_force.sel(component="z")) for s in (wall, bottom)]
print(f"weight {weight:.3f} N = side {held[0]:.3f} N + floor {held[1]:.3f} N")

# %%
# Forces on the side and the floor add up to the weight, to the digits of the files. The law's assumptions hold less
# well: near the floor the vertical stress falls again, so that the floor carries 18 % of the weight, where the law has
# 26 %. The waves of the pressure on the side are the unevenness of one packing: less than 5 grains lie between them.
#
# **For your own data, change** the cylinder to your silo's, and ``walls=`` to the names of your walls (``print(ds.cg)``
# shows them; :doc:`walls of other shapes </walls>` are planes and triangles). The page on walls has this silo's
# pressure unrolled over the angle.
