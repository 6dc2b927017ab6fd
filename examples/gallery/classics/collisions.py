r"""
Collisions of a gas: births and lifetimes of contacts
=====================================================

Kinetic theory knows how often the spheres of a gas collide: each :math:`4 n d^2 \chi \sqrt{\pi T}` times per time
(Enskog), with diameter :math:`d`, number density :math:`n`, temperature :math:`T`, mass 1, and the pair correlation at
contact :math:`\chi = (1 - \phi/2) / (1 - \phi)^3` (Carnahan & Starling 1969). A contact by a linear spring lasts half a
period of its pair.

The gas is the first step of a simulation (LAMMPS, :download:`cooling.in
<../../../examples/data/lammps_cooling/cooling.in>`): 2000 smooth spheres of diameter 1 in a periodic box, with a volume
fraction of 0.1. Here it goes on without losses for half a unit of time, and is recorded ten times as often as contacts
last.
"""

import matplotlib.pyplot as plt
import numpy as np

import xcg

start = xcg.datasets.open("cooling").isel(time=0).compute()
box = start.box.to_numpy()
edges = np.diff(box, axis=1).ravel()
radius = 0.5 * start.diameter.to_numpy()
contact_time = 0.02
stiffness = np.pi**2 / (2 * contact_time**2)  # half a period, for the reduced mass 1/2


def force(position):
    """Return the forces of linear springs between spheres that overlap."""
    i, j = xcg.find_pairs(position, radius, box, "xyz").T
    branch = position[i] - position[j]
    branch -= edges * np.round(branch / edges)
    distance = np.linalg.norm(branch, axis=1, keepdims=True)
    push = stiffness * (1 - distance) * branch / distance
    total = np.zeros_like(position)
    np.add.at(total, i, push)
    np.add.at(total, j, -push)
    return total


position = start.position.to_numpy()
velocity = start.velocity.to_numpy()
step = contact_time / 20
push = force(position)
recorded = []
for k in range(500):
    velocity = velocity + push * step / 2
    position = position + velocity * step
    push = force(position)
    velocity = velocity + push * step / 2
    if k % 2 == 0:
        recorded.append(position)
ds = xcg.scene_from_arrays(
    recorded,
    diameter=np.tile(2 * radius, (len(recorded), 1)),
    time=2 * step * np.arange(len(recorded)),
    box=box,
    periodic="xyz",
)

# %%
# ``contact_history`` follows contacts from step to step by the ids of their particles. ``persistence`` is the share of
# contacts that are still there after a lag: with contacts of one length :math:`t_c`, it is :math:`1 - t / t_c`.

h = ds.cg.find_contacts().cg.contact_history(lags=12)
fraction = float(start.volume.sum()) / edges.prod()
temperature = float((start.velocity**2).sum()) / (3 * len(radius))
chi = (1 - fraction / 2) / (1 - fraction) ** 3
rate = 4 * len(radius) / edges.prod() * chi * np.sqrt(np.pi * temperature)
collisions = rate * len(radius) / 2 * ds.time

fig, (left, right) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
left.plot(h.time, h.births.cumsum())
left.plot(h.time, collisions, "k--", label="Enskog")
left.set(xlabel="time", ylabel="contacts born")
left.legend()
right.errorbar(h.lag / contact_time, h.persistence, h.persistence_error, fmt="o")
right.plot([0, 1, 1.3], [1, 0, 0], "k--", label="equal contacts")
right.set(xlabel="lag over half a period", ylabel="persistence")
right.legend()
plt.show()

# %%
# **Check.** Contacts last half a period, less a percent: spheres that overlap also move sideways, and so apart. And as
# many are born as collide.

measured = float(h.lifetime.mean())
expected = contact_time
print(f"lifetime {measured:.4f}, half a period {expected:.4f}")
print(f"births {int(h.births.sum())}, Enskog {float(collisions[-1]):.0f}")

# %%
# **For your own data, change** the scene to that of your files, with contacts. Steps have to be closer in time than
# contacts last; a gap among them is named in a warning.
