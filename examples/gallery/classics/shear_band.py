r"""
Biaxial test: shear band and force chains
=========================================

A dense sample that is shortened along one axis at a constant stress across it yields in bands. The Mohr circle of the
stresses at the peak, :math:`\sin\varphi = (\sigma_1 - \sigma_3)/(\sigma_1 + \sigma_3)`, says at which angle to the axis
of :math:`\sigma_3`: :math:`45° + \varphi/2` after Coulomb.

2400 discs in a periodic box were squeezed to an even stress of 1 (contact stiffness 2000), and then shortened along y,
while the stress along x stayed 1. The script of the simulation (LAMMPS) is :download:`biaxial.in
<../../../examples/data/lammps_biaxial/biaxial.in>`.
"""

import matplotlib.pyplot as plt
import numpy as np

import xcg

ds = xcg.datasets.open("biaxial")  # shortened by 0, 2 and 6 %
mean = ds.cg.coarse_grain("stress", axes="", at={}).stress.compute()
s3 = mean.sel(component="x", direction="x")
s1 = mean.sel(component="y", direction="y")
friction = np.degrees(np.arcsin((s1 - s3) / (s1 + s3)))

late = ds.isel(time=[1, 2])
u = late.cg.displacement(["shear_strain", "displacement_gradient"], width="2 d43", spacing=0.5)
u = u.isel(time=0).compute()

fig, ax = plt.subplots(figsize=(5.2, 6.5))
image = ax.pcolormesh(u.x, u.y, u.shear_strain.transpose("y", "x"), vmin=0, vmax=0.3)
fig.colorbar(image, label="shear strain, from 2 to 6 % of shortening", extend="max")
ax.set(xlabel="$x$", ylabel="$y$", aspect="equal")
plt.show()

# %%
# The angle of the bands is that at which strains ten diameters apart resemble each other most; both directions count
# alike.

strain = u.shear_strain.transpose("x", "y").values
power = abs(np.fft.fft2(strain - strain.mean())) ** 2
like = np.fft.ifft2(power).real / np.fft.ifft2(power).real[0, 0]
angles = np.arange(30, 81)
steps = np.rint(
    10 * np.array([np.cos(np.radians(angles)), np.sin(np.radians(angles))]) / 0.5
).astype(int)
resemblance = like[steps[0], steps[1]] + like[steps[0], -steps[1]]
band = angles[resemblance > 0.98 * resemblance.max()].mean()
coulomb = 45 + float(friction[1]) / 2

fc = ds.isel(time=[1]).cg.force_chains(alpha=45, min_stress="mean").compute()
fig, ax = plt.subplots(figsize=(5.2, 6.5))
fc.cg.plot_chains(index=0, ax=ax)
ax.set(xlabel="$x$", ylabel="$y$", title="force chains at 2 %")
plt.show()

# %%
# **Check.** The angle of the bands, and that the fields' deformation is that of the box:

box = ds.box.diff("bound").squeeze("bound")
stretch = box.isel(time=2) / box.isel(time=1) - 1
H = u.displacement_gradient.mean(["x", "y"])
print(f"angle of friction at 2 %: {float(friction[1]):.1f} degrees")
print(f"bands at {band:.0f} degrees, after Coulomb {coulomb:.0f}")
for c in "xy":
    found = float(H.sel(component=c, direction=c))
    imposed = float(stretch.sel(component=c))
    print(f"strain along {c}: fields {found:.4f}, box {imposed:.4f}")

# %%
# The angle is known to some degrees: two pairs of bands in one sample, and a periodic box lets bands only close where
# they fit. The friction is that of the step at 2 %; its largest value may lie beside it. Force chains run along the
# larger stress, and bend at bands.
#
# **For your own data, change** ``isel(time=...)`` to the two steps that you compare, and ``width``, which a band must
# be wider than. In boxes with walls, leave the mean of the box out and look at the middle of the sample. More:
# :doc:`displacement and strain </displacement>`, :doc:`force chains </chains>`.
