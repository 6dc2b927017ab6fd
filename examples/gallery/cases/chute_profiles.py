r"""
Chute flow: Bagnold's profile
=============================

In a steady flow down a rough plane friction is the tangent of the angle at every height. If friction depends on the
inertial number :math:`I` alone, :math:`I` is the same at every height, too, and the velocity has Bagnold's profile

.. math:: V_x = V_0 + \tfrac 2 3 A\,\bigl(h^{3/2} - (h - z)^{3/2}\bigr), \qquad A = I \sqrt{\phi\, g \cos\theta} / d .

4398 spheres (:math:`d = m = g = 1`) flow down a plane of :math:`\theta` = 24 degrees, over spheres that are held in
place; this is one step. The script of the simulation (LAMMPS) is :download:`chute.in
<../../../examples/data/lammps_chute/chute.in>`.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import curve_fit

import xcg

ds = xcg.datasets.open("chute")  # with force_z, the total force on each grain, for the check
wanted = [
    "density",
    "volume_fraction",
    "velocity",
    "inertial_number",
    "contact_stress",
    "granular_temperature",
]
wanted.append(xcg.Sum("force_z"))
# it warns that noise alone makes up an inertial number of 0.035 in a single step, a seventh of that of this flow
f = (
    ds.cg.coarse_grain(wanted, errors=True, axes="z", bounds={"z": (0, 25)}, spacing=0.25)
    .isel(time=0)
    .compute()
)
V = f.velocity.sel(component="x")

# %%
# :math:`V_0`, :math:`A` and the height :math:`h` are fitted to the velocity between the bed and the surface:


def bagnold(z, V0, A, h):
    return V0 + 2 / 3 * A * (h**1.5 - np.maximum(h - z, 0) ** 1.5)


flow = f.sel(z=slice(2, 20))
(V0, A, h), _ = curve_fit(bagnold, flow.z, flow.velocity.sel(component="x"), p0=(0, 0.2, 20))

fig, (ax, right) = plt.subplots(1, 2, sharey=True, layout="constrained")
ax.plot(V, f.z, "o", ms=4, label="coarse-grained")
ax.plot(bagnold(flow.z, V0, A, h), flow.z, "k-", label="Bagnold's profile")
ax.set(xlabel=r"velocity $V_x$ [$\sqrt{g d}$]", ylabel="height $z$", ylim=(None, 30))
ax.legend(loc="upper left")
T = f.granular_temperature
noise = f.granular_temperature_error
right.fill_betweenx(f.z, T - 2 * noise, T + 2 * noise, alpha=0.3, lw=0, label="two standard errors")
right.plot(T, f.z, label="coarse-grained")
right.set(xlabel="granular temperature [$g d$]")
right.legend(loc="upper right")
plt.show()

inertial = flow.inertial_number.median()
from_I = float(inertial * np.sqrt(flow.volume_fraction.mean() * np.cos(np.radians(24))))
print(
    f"A = {A:.3f} by the velocity, {from_I:.3f} by the inertial number, whose median is {inertial:.2f}"
)
print(
    f"largest difference of the velocity from the fit: {abs(bagnold(flow.z, V0, A, h) - V).max():.2f}"
)
print(
    f"noise of the velocity in this step: {f.velocity_error.sel(z=slice(2, 20), component='x').mean():.2f}"
)

# %%
# The band is the noise of one step (:doc:`standard errors </width>`). That of the velocity is too small to be
# seen: its difference from the fit is not noise, but the flow's own.

# %%
# **Check.** At every height the contacts carry the weight of the grains above, and what accelerates them: the flow is
# steady on average only. With the total force :math:`F_i` on each grain, which is a column of the file,
# :math:`\sigma^c_{zz}(z) = \int_z^\infty \bigl(\rho g \cos\theta + \sum_i F_{iz} \Psi\bigr) dz'` holds at any moment.

weight = -f.density * ds.attrs["gravity"][2]
above = [(q.integrate("z") - q.cumulative_integrate("z")) for q in (weight, weight + f.sum_force_z)]
stress = f.contact_stress.sel(component="z", direction="z")

fig, ax = plt.subplots()
ax.plot(stress, f.z, "o", ms=4, label=r"contact stress $\sigma^c_{zz}$")
ax.plot(above[0], f.z, "k--", label="weight above")
ax.plot(above[1], f.z, "k-", label="and accelerations above")
ax.set(xlabel="stress [$m g / d^2$]", ylabel="height $z$")
ax.legend()
plt.show()

carried = float(stress.sel(z=5))
load = float(above[1].sel(z=5))
at_5 = f"{load:.2f} with accelerations, {above[0].sel(z=5):.2f} by weight alone"
print(f"at z = 5 contacts carry {carried:.2f}; what is above makes {at_5}")

# %%
# The two agree to the 0.1 % that half a time step between forces and velocities costs. Below :math:`z = 2` the spheres
# that are fixed in place carry the rest. Weight alone is a few per cent off in a single step, as the layer goes up and
# down a little.
#
# **For your own data, change** the line that opens them to ``xcg.open_scene("particles.*.dump", contacts=
# "contacts.*.dump", gravity=...)``, the range of ``z``, and the angle. With many steps, ``f.cg.time_average()`` makes
# :doc:`averages with their errors </evaluation>`, and weight is enough.
