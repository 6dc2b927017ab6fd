r"""
Gas of spheres: pair correlation
================================

In a gas of hard spheres others stand close to each sphere more often than at random. At contact the radial distribution
is :math:`g(d) = (1 - \phi/2) / (1 - \phi)^3` (Carnahan & Starling 1969), which is the factor by which kinetic theory
raises the rate of collisions; further away it is 1.

2000 smooth spheres in a periodic box, with a volume fraction of 0.1, start as a gas in equilibrium and cool. The script
of the simulation (LAMMPS) is :download:`cooling.in <../../../examples/data/lammps_cooling/cooling.in>`.
"""

import matplotlib.pyplot as plt
import numpy as np

import xcg

ds = xcg.datasets.open("cooling").compute()

# %%
# ``radial_distribution`` counts pairs by distance; ``structure_factor`` measures density waves, of which long ones are
# weak in a gas that resists compression. Percus and Yevick's theory gives both; at this density its
# :math:`S(0) = (1 - \phi)^4 / (1 + 2\phi)^2`.

g = ds.cg.radial_distribution(4.0, bins=80).radial_distribution.mean("time")
S = ds.cg.structure_factor(20.0, bins=60).structure_factor.mean("time")
phi = np.pi / 6 * ds.sizes["particle"] / float(np.prod(np.diff(ds.box[0], axis=-1)))
expected = (1 - phi / 2) / (1 - phi) ** 3

fig, (left, right) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
left.plot(g.r, g, drawstyle="steps-mid")
left.axhline(1, color="0.6", ls=":")
left.plot(1, expected, "ko", label="Carnahan & Starling")
left.set(xlabel="distance $r$", ylabel="radial distribution $g$")
left.legend()
right.plot(S.k, S)
right.axhline(
    (1 - phi) ** 4 / (1 + 2 * phi) ** 2, color="k", ls="--", label="Percus & Yevick, $S(0)$"
)
right.set(xlabel="wavenumber $k$", ylabel="structure factor $S$")
right.legend()
plt.show()

# %%
# **Check.** The value at contact, continued from near pairs and averaged over the steps, is Carnahan and Starling's.

found = ds.cg.contact_value(1.3)
measured = float(found.contact_value.mean("time"))
error = float(found.contact_value.std("time")) / np.sqrt(found.sizes["time"])
print(f"g(d) = {measured:.2f} +- {error:.2f}, Carnahan & Starling {expected:.2f}")

# %%
# ``bond_order`` compares the directions of the 12 nearest neighbours. If these are independent, the mean of
# :math:`q_6^2` is 1/12. In a gas it is a little less, as neighbours keep apart from each other; in a face-centred cubic
# crystal :math:`q_6` is 0.575.

order = ds.cg.bond_order([6])
root_mean_square = float(np.sqrt((order.q6**2).mean()))
print(f"q6 = {root_mean_square:.3f}, independent directions {12**-0.5:.3f}")

# %%
# **For your own data, change** the name in ``xcg.datasets.open`` to your files. Along axes that are not periodic,
# ``bounds`` say which part the grains fill (:doc:`structure </microstructure>`).
