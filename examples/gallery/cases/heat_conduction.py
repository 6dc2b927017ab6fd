r"""
Heat in packings and flows
==========================

Heat goes from grain to grain through small contacts, so a bed of grains conducts far less than what they are made of.
Where the gas between them does not count, a contact of radius :math:`a` lets :math:`Q_{ij} = 2 k a (T_j - T_i)`
through, with :math:`k` the conductivity of the grains (Batchelor & O'Brien, *Proc. R. Soc. Lond. A* 355 (1977) 313).
Then the temperatures of all grains are those of a network of resistors, and the field of the flux tells the
conductivity of the bed.

3800 glass beads of 4.5 to 5.5 mm rest in a silo. The script of the simulation (LAMMPS) is :download:`silo.in
<../../../examples/data/lammps_silo/silo.in>`. Here the lowest grains are held at 330 K and the highest at 300 K; walls
let no heat through.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.sparse import coo_array, diags_array
from scipy.sparse.linalg import spsolve

import xcg

ds = xcg.datasets.open("silo").compute()
k, stiffness = (
    1.0,
    5e9,
)  # conductivity of glass (W/m/K); effective modulus of Hertz's law for a contact of glass (Pa)
now = ds.isel(time=0)
z = now.position.sel(component="z").values
radius = now.diameter.values / 2

# %%
# Hertz's law relates the radius of a contact to its force, :math:`a^3 = 3 f R^* / 4 E^*`. Walls have no grain at the
# other side, and conduct nothing.

row = {number: n for n, number in enumerate(now.particle_id.values)}
i, j = (
    np.array([row.get(number, -1) for number in now[name].values])
    for name in ("contact_i", "contact_j")
)
inside = (i >= 0) & (j >= 0)
i = i[inside]
j = j[inside]
force = np.linalg.norm(now.contact_force.values[inside], axis=1)
a = (0.75 * force * radius[i] * radius[j] / (radius[i] + radius[j]) / stiffness) ** (1 / 3)
conductance = 2 * k * a

# %%
# In a steady state, each grain that is not held receives as much as it gives. Grains that touch no other would have any
# temperature: a conductance of almost nothing to the mean takes them there.

n = len(z)
held = (z < 0.01) | (z > z.max() - 0.02)
T = np.where(z < 0.1, 330.0, 300.0)
between = coo_array((conductance, (i, j)), (n, n)).tocsr()
between = between + between.T
network = diags_array(between.sum(axis=1) + 1e-16) - between
free = ~held
network = network.tocsr()
T[free] = spsolve(network[free][:, free].tocsc(), 1e-16 * 315 - network[free][:, held] @ T[held])

heat = np.zeros(len(inside))
heat[inside] = conductance * (T[j] - T[i])  # what i receives from j
ds = ds.assign(
    temperature=(("time", "particle"), T[None], {"units": "K"}),
    contact_heat=(("time", "contact"), heat[None], {"units": "W"}),
)

# %%
# ``Conduction`` is the flux of what flows along contacts, ``Mean`` the temperature of the grains.

asked = [xcg.Mean("temperature", "number"), xcg.Conduction("contact_heat"), "volume_fraction"]
cut = ds.cg.coarse_grain(asked, at={"y": 0.0}, axes="xz", spacing=0.002).isel(time=0).compute()
filled = cut.volume_fraction > 0.2

fig, ax = plt.subplots(figsize=(4.5, 7))
cut[["temperature"]].where(filled).cg.plot(ax=ax, cmap="YlOrRd")
q = cut.conduction_contact_heat.where(filled).isel(x=slice(1, None, 3), z=slice(1, None, 5))
along, up = (q.sel(component=c).transpose("z", "x") for c in "xz")
ax.quiver(
    q.x, q.z, along, up, angles="xy", scale_units="xy", scale=float(up.mean()) / 0.007, width=0.012
)
ax.set(xlabel="$x$ [m]", ylabel="$z$ [m]", aspect="equal", title="", xticks=[-0.02, 0, 0.02])
plt.show()

# %%
# Profiles over the height are averages over the section :math:`A` of the silo. The conductivity of the bed follows
# from the flux :math:`q` and the slope of the temperature, :math:`k_e = -q / (dT/dz)`. Temperatures of single grains
# scatter, so that the kernel is wider here.

R = 0.025
extent = {"x": np.pi * R, "y": R}  # their product is the section
f = ds.cg.coarse_grain([*asked, "stress"], axes="z", width="2 d43", spacing=0.005, extent=extent)
f = f.isel(time=0).compute().sel(z=slice(0.035, 0.185))
flux = f.conduction_contact_heat.sel(component="z")
conductivity = -flux / f.temperature.differentiate("z")

fig, (left, right) = plt.subplots(1, 2, sharey=True)
left.plot(f.temperature, f.z, "o", ms=4)
left.set(xlabel="temperature [K]", ylabel="height $z$ [m]")
pressure = f.stress.sel(component="z", direction="z")
scale = float((conductivity / pressure ** (1 / 3)).mean())
right.plot(1e3 * conductivity, f.z, "o", ms=4, label="$k_e$")
right.plot(1e3 * scale * pressure ** (1 / 3), f.z, "k-", label=r"$\propto \sigma_{zz}^{1/3}$")
right.set(xlabel="conductivity [mW/m/K]", xlim=(0, None))
right.legend()
plt.show()

# %%
# **Check.** Heat is not lost on the way: through each height flows what the warm grains give.

warm = held & (z < 0.1)
given = (heat[inside] * (warm[j] & ~warm[i])).sum() - (heat[inside] * (warm[i] & ~warm[j])).sum()
flow = flux * np.pi * R**2
carried = float(flow.mean())
print(
    f"given {1e3 * given:.6f} mW, carried {1e3 * carried:.6f} mW, largest difference {abs(flow / given - 1).max():.1e}"
)
low = 1e3 * float(conductivity.min())
high = 1e3 * float(conductivity.max())
print(f"conductivity of the bed {low:.1f} to {high:.1f} mW/m/K, of glass {k} W/m/K")

# %%
# Both agree at all heights to what the solver leaves, as the flux along contacts is exact: there is no mesh in it. The
# bed conducts less than a hundredth of what glass does, as contacts are a two-hundredth of a grain's radius wide. Their
# radii grow with the third root of the force, and the conductivity nearly with that of the pressure.
#
# Heat that grains carry
# ----------------------
# In a gas or a flow, grains also take their heat along. ``Flux`` is what fluctuations carry of any variable of grains,
# :math:`\sum (T_i - \langle T \rangle)(v_i - V) \Psi` here. Times the heat capacity of a grain it is the convective
# flux of heat, to which that of contacts adds. 2000 grains of a gas start with a temperature that is a wave along z,
# and exchange no heat. So the wave fades as fast as grains diffuse.

gas = xcg.datasets.open("cooling").compute()
low, high = gas.box.isel(time=0).sel(component="z").values
k = 2 * np.pi / (high - low)
start = 300 + 30 * np.cos(k * (gas.position.isel(time=0).sel(component="z", drop=True) - low))
gas = gas.assign(temperature=start.broadcast_like(gas.diameter).assign_attrs(units="K"))
names = [xcg.Flux("temperature", "number"), xcg.Mean("temperature", "number")]
f = gas.cg.coarse_grain(
    [*names, "number_density", "granular_temperature", "volume_fraction"], axes="z", width="2 d43"
)

wave = 2 * (f.temperature * np.cos(k * (f.z - low))).mean("z")
convective = 2 * (f.flux_temperature.sel(component="z") * np.sin(k * (f.z - low))).mean("z")
n = float(f.number_density.mean())
phi = float(f.volume_fraction.mean())
diffusivity = convective / (n * k * wave)  # flux over the slope of the temperature

# %%
# Kinetic theory (Enskog) has the diffusivity of spheres of :math:`d = m = 1` at a granular temperature :math:`T_g`,
# :math:`D = 1.019 \cdot 3 / (8 n \chi) \sqrt{T_g / \pi}` with :math:`\chi = (1 - \phi / 2) / (1 - \phi)^3`.

chi = (1 - phi / 2) / (1 - phi) ** 3
theory = 1.019 * 3 / (8 * n * chi) * np.sqrt(f.granular_temperature.mean("z") / np.pi)
fig, ax = plt.subplots()
ax.plot(f.time[1:], diffusivity[1:], "o", label="flux of heat over the slope of the temperature")
ax.plot(f.time, theory, "k-", label="kinetic theory")
ax.set(
    xlabel=r"time [$d / \sqrt{T_0}$]", ylabel=r"diffusivity $D$ [$d \sqrt{T_0}$]", ylim=(0, None)
)
ax.legend()
plt.show()

# %%
# **Check.** What is carried is what the wave loses: :math:`A(t) = A(0) \exp(-k^2 \int D dt)`. At the start temperatures
# do not depend on velocities, so nothing is carried yet; the first interval is left out.

faded = float(np.log(wave[1] / wave[-1]))
print(
    f"the wave faded by exp(-{faded:.2f}), by the flux exp(-{k**2 * float(diffusivity[1:].integrate('time')):.2f})"
)
print(f"diffusivity over that of kinetic theory: {float((diffusivity / theory)[1:].mean()):.2f}")

# %%
# **For your own data, change** the name in ``xcg.datasets.open`` to your files. Where your code writes the heat of each
# contact, name its column ``contact_heat`` and leave the network out.
