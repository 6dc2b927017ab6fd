r"""
Rods in shear: alignment
========================

A rod in a shear flow turns fast while it stands across the flow and slowly while it lies along it. Jeffery's equation
for a rod of aspect ratio :math:`r` in the plane of a shear rate :math:`\dot\gamma` (*Proc. R. Soc. Lond. A* 102 (1922)
161) has the solution :math:`r \tan\varphi = \tan(\psi_0 - \dot\gamma t\, r / (r^2 + 1))`, with :math:`\varphi` the
angle to the flow. Over long times the mean of :math:`\cos 2\varphi` is :math:`(r - 1) / (r + 1)`.

The rods here are synthetic: 4398 spheres that flow down a rough plane carry a director each, which follows Jeffery's
equation at the shear rate of its depth. The script of the flow (LAMMPS) is :download:`chute.in
<../../../examples/data/lammps_chute/chute.in>`.
"""

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr

import xcg

ds = xcg.datasets.open("chute").isel(time=[0]).compute()
aspect = 3.0

# %%
# A profile of the velocity gives the shear rate of each depth.

profile = ds.cg.coarse_grain("velocity_gradient", axes="z", width="2 d43").isel(time=0).compute()
slope = profile.velocity_gradient.sel(component="x", direction="z").dropna("z")
rate = np.interp(ds.position.sel(component="z"), slope.z, slope)  # (time, particle)

# %%
# At first, rods point in any direction of the plane of shear. They are followed over mean strains from 0 to 60.

rng = np.random.default_rng(1)
first = rng.uniform(0, np.pi, rate.shape)
phase = np.arctan2(aspect * np.sin(first), np.cos(first))
time = np.arange(0.0, 60.0, 1.0) / rate.mean()
turned = phase - rate * time[:, None] * aspect / (aspect**2 + 1)
angle = np.arctan2(np.sin(turned), aspect * np.cos(turned))
director = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=-1)
rods = xr.concat([ds.assign_coords(time=[t]) for t in time], "time", data_vars="minimal")
rods = rods.assign(director=(("time", "particle", "component"), director))

# %%
# The largest eigenvalue of ``nematic_tensor`` is 0 where directors are spread evenly over all directions, 1/4 where
# they are spread evenly in a plane, and 1 where they are parallel. ``nematic_order`` is the eigenvalue of largest
# modulus: the same once most rods are along one axis, and -1/2, along the normal of the plane, before. A warning says
# that rods at random have an order of 0.03 at these nodes.

names = ["nematic_tensor", "nematic_order", "nematic_director"]
whole = rods.cg.coarse_grain(names, axes="", at={}, for_averages=True).compute()
expected_2d = (aspect - 1) / (aspect + 1)
expected = (
    1 + 3 * expected_2d
) / 4  # largest eigenvalue of (3 <n n> - I) / 2 for directors in a plane

fig, (left, right) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
largest = whole.cg.principal("nematic_tensor").nematic_tensor_principal.sel(principal=1)
left.plot(time * rate.mean(), largest, label="all rods")
left.axhline(expected, color="k", ls="--", label="Jeffery, long times")
left.axhline(0.25, color="0.6", ls=":", label="even in the plane")
left.set(xlabel="mean shear strain", ylabel="largest eigenvalue of $Q$", ylim=(0, 1))
left.legend()
layers = rods.isel(time=[0, 5, 15, 59]).cg.coarse_grain(names, axes="z", width="2 d43").compute()
of_layers = layers.cg.principal("nematic_tensor").nematic_tensor_principal.sel(principal=1)
for k, (strain, style) in enumerate({0: ":", 5: "-.", 15: "--", 59: "-"}.items()):
    right.plot(of_layers.isel(time=k), layers.z, style, label=f"strain {strain}")
right.set(xlabel="largest eigenvalue of $Q$", ylabel="height $z$", xlim=(0, 1))
right.legend(loc="center left", bbox_to_anchor=(1, 0.5))
plt.show()

# %%
# The order of all rods swings while they turn together, and settles as layers of different shear rate get out of step.
#
# **Check.** Averages over time average the tensor and find its order anew. Over the second half of the strain it is
# Jeffery's.

late = whole.isel(time=slice(30, None, 2)).cg.time_average()  # steps are correlated
measured = float(late.nematic_order)
along = np.degrees(np.arctan2(*(late.nematic_director.sel(component=c).item() for c in "zx")))
print(
    f"order {measured:.3f}, Jeffery {expected:.3f}; the mean axis is {along:.1f} degrees from the flow"
)

# %%
# **For your own data, change** the name in ``xcg.datasets.open`` to your files, and leave out Jeffery's equation: your
# code writes quaternions, from which ``ds.cg.derive_director()`` makes the directors (:doc:`fabric </microstructure>`).
