r"""
Cooling gas: Haff's law
=======================

Smooth spheres that lose energy in each collision cool without end: the granular temperature falls as :math:`T = T_0 /
(1 + t/\tau)^2` (Haff 1983), and kinetic theory says :math:`\tau` without anything to fit.

2000 spheres with a restitution :math:`e = 0.9` start as a gas in equilibrium in a periodic box, with a volume fraction
of 0.1. The script of the simulation (LAMMPS) is :download:`cooling.in
<../../../examples/data/lammps_cooling/cooling.in>`.
"""

import matplotlib.pyplot as plt
import numpy as np

import xcg

ds = xcg.datasets.open("cooling")
names = ["granular_temperature", "volume_fraction"]
f = ds.cg.coarse_grain(names, errors=True, axes="", at={}).compute()  # means of the box
T = f.granular_temperature
phi = f.volume_fraction

# %%
# Each sphere of diameter :math:`d` in a gas of elastic spheres collides at the rate :math:`\omega = 4 n d^2 \chi
# \sqrt{\pi T}` (Enskog; Chapman & Cowling 1970), with :math:`n` the number of spheres per volume. The factor
# :math:`\chi = (1 - \phi/2) / (1 - \phi)^3` is how much more often two spheres touch than at low density (Carnahan &
# Starling 1969).
#
# Two spheres collide with a relative velocity :math:`v_n` along the line of their centres. Over all collisions the mean
# of :math:`v_n^2` is :math:`4 T`. A collision takes the energy :math:`m (1 - e^2) v_n^2 / 4`, half of it from each
# sphere. That is the share :math:`(1 - e^2)/3` of the mean energy of a sphere, :math:`3 m T / 2`, so :math:`\dot T =
# -(1 - e^2)\, \omega\, T / 3`. As :math:`\omega` is proportional to :math:`\sqrt T`, the solution is Haff's law with
# :math:`1/\tau = (1 - e^2)\,\omega_0 / 6`.

e, d = 0.9, 1.0
n = 6 * phi[0] / (np.pi * d**3)
chi = (1 - phi[0] / 2) / (1 - phi[0]) ** 3
tau = float(6 / ((1 - e**2) * 4 * n * d**2 * chi * np.sqrt(np.pi * T[0])))
law = T[0] / (1 + T.time / tau) ** 2

fig, ax = plt.subplots()
ax.errorbar(
    T.time,
    T,
    2 * f.granular_temperature_error,
    fmt="o",
    label="coarse-grained, two standard errors",
)
ax.set_yscale("log")
ax.semilogy(T.time, law, "k-", label=f"Haff's law, $\\tau$ = {tau:.1f}")
ax.set(xlabel=r"time [$d / \sqrt{T_0}$]", ylabel=r"granular temperature [$T_0$]")
ax.legend()
plt.show()

# %%
# **Check.** In the law :math:`\sqrt{T_0/T}` is a straight line over time, of slope :math:`1/\tau`:

fitted = 1 / np.polyfit(T.time, np.sqrt(T[0] / T), 1)[0]
print(f"tau = {fitted:.2f} in the simulation, {tau:.2f} by kinetic theory")
print(f"largest difference of T from the law: {100 * float(abs(T / law - 1).max()):.1f} %")
print(
    f"standard error of T in one step: {100 * float((f.granular_temperature_error / T).mean()):.1f} %"
)

# %%
# The rest is the noise of 2000 grains, and what kinetic theory leaves out: velocities in a cooling gas are not quite
# Gaussian. A gas that is larger or loses more energy does not stay uniform; then ask for maps (``axes="xz"``), where
# dense clusters stand out.
#
# **For your own data, change** the line that opens them to ``xcg.open_scene("particles.*.dump")``, and ``e``. Where
# grains are not alike, see :doc:`how a temperature is measured </temperature>`.
