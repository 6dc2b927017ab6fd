r"""
Dense suspension: viscous number
================================

Where the fluid is so viscous that inertia does not matter, the viscous number describes a suspension: :math:`J = \eta_f
\dot\gamma / P`: its volume fraction :math:`\phi`, its friction :math:`\mu = \tau / P`, and its viscosity :math:`\eta_s
= \mu / J` in units of the fluid's are functions of :math:`J`. Boyer, Guazzelli & Pouliquen (2011) measured :math:`\phi
= \phi_m / (1 + \sqrt J)` with :math:`\phi_m = 0.585`, and took the part of friction that contacts make as :math:`\mu_c
= 0.32 + 0.38 / (1 + 0.005 / J)`.

400 frictional spheres are sheared at five volume fractions, six steps each, in a box that turns with the shear. The
fluid is there as a drag only, towards the mean flow. The drag is Stokes' on a single sphere times :math:`(1 - \phi)
[10 \phi / (1 - \phi)^2 + (1 - \phi)^2 (1 + 1.5 \sqrt\phi)]`, as van der Hoef, Beetstra & Kuipers (2005) computed it
for spheres at rest. The script of the simulation (LAMMPS) is :download:`suspension.in
<../../../examples/data/lammps_suspension/suspension.in>`.
"""

import matplotlib.pyplot as plt
import numpy as np

import xcg

ds = xcg.datasets.open(
    "suspension"
)  # mean diameter, rate of shear and viscosity of the fluid are 1
names = ["volume_fraction", "viscous_number", "relative_viscosity"]
options = {"fluid_viscosity": 1.0, "shear_dims": "xy", "pressure_dims": "y"}
f = ds.cg.coarse_grain(names, axes="y", width=1.0, for_averages=True, **options).compute()
m = f.cg.time_average(window=6, every=6).mean("y")  # one for each volume fraction
J = m.viscous_number
phi = m.volume_fraction
eta = m.relative_viscosity

# %%
# Each average has its error, by the scatter of the steps.

curve = np.geomspace(5e-4, 0.3)
mu_c = 0.32 + 0.38 / (1 + 0.005 / curve)

fig, ax = plt.subplots()
ax.errorbar(J, phi, xerr=m.viscous_number_error, fmt="o", label="coarse-grained")
ax.plot(curve, 0.585 / (1 + np.sqrt(curve)), "k-", label="Boyer et al. 2011")
ax.set(xscale="log", xlabel="viscous number $J$", ylabel=r"volume fraction $\phi$")
ax.legend()
plt.show()

# %%
# What contacts add to the viscosity, against the part of the measured one that is theirs:

fig, ax = plt.subplots()
ax.errorbar(J, eta, yerr=m.relative_viscosity_error, fmt="o", label="coarse-grained")
ax.plot(curve, mu_c / curve, "k-", label="contacts, Boyer et al.")
ax.set(
    xscale="log", yscale="log", xlabel="viscous number $J$", ylabel=r"viscosity $\eta_s$ [$\eta_f$]"
)
ax.legend()
plt.show()

# %%
# **Check.** The volume fraction at which the suspension no longer flows: where :math:`1 / \phi = (1 + a \sqrt J) /
# \phi_m` meets :math:`J = 0`.

slope, start = np.polyfit(np.sqrt(J), 1 / phi, 1)
jammed = 1 / start
measured = 0.585
print(f"phi_m = {jammed:.3f}, measured {measured}; a = {slope / start:.2f}, measured 1")
print("mu    =", (eta * J).round(2).values)
print("mu_c  =", (0.32 + 0.38 / (1 + 0.005 / J)).round(2).values)

# %%
# At the same viscous number the volume fraction is within 0.04 of the measured one, and the friction within a third of
# what is ascribed to contacts. What is missing is the rest of the fluid. A drag does not push grains apart that come
# close, so that between the ends of the curve the pressure is too low by a factor of two to three. The fluid's own
# share of the stress, :math:`J + \frac 5 2 \phi_m \sqrt J` of friction in Boyer et al., is in no force between grains;
# add it to compare with a rheometer. With Stokes' drag alone, which is about ten times weaker at :math:`\phi = 0.5`,
# the pressure was about eight times lower.
#
# **For your own data, change** the line that opens them to ``xcg.open_scene("particles.*.dump",
# contacts="contacts.*.dump")``, the viscosity, and the axes of ``options``: the first is the flow, ``pressure_dims``
# the normal of the plates. A flow that is not uniform has a profile of :math:`J`; leave ``mean("y")`` out. See
# :doc:`void fraction and drag </cfd_dem>`.
