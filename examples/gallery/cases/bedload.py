r"""
Bedload transport
=================

A river moves the grains of its bed by the drag on those at the surface. Layer by layer grains take over the stress of
the fluid, and deeper down they bear it at rest, where their weight holds them.

1000 spheres of 1 mm are sheared from above by a viscous fluid, whose velocity is given; it acts on them by Stokes'
drag. The script of the simulation (LAMMPS) is :download:`bedload.in
<../../../examples/data/lammps_bedload/bedload.in>`.
"""

import matplotlib.pyplot as plt

import xcg

ds = xcg.datasets.open("bedload")  # with the drag on each grain along x, as the code wrote it
names = ["density", "velocity", "stress", xcg.Sum("drag")]
f = ds.cg.coarse_grain(
    names, axes="z", width=5e-4, bounds={"z": (0, 0.01)}, spacing=1e-4, for_averages=True
)
m = f.cg.time_average().compute()
z = 1e3 * m.z

# %%
# From the top of the flow down into the bed the velocity falls by four orders of magnitude:

speed = m.velocity.sel(component="x")
fig, ax = plt.subplots()
ax.semilogx(speed.where(speed > 3e-5), z, "o-", ms=4)
ax.set(xlabel="velocity $V_x$ [m s$^{-1}$]", ylabel="height $z$ [mm]")
plt.show()

# %%
# **Check.** In a steady state the grains' stress balances all that acts on them above: :math:`\sigma_{zz}` their weight
# (less the buoyancy), and :math:`-\sigma_{xz}` the drag.


def above(q):
    return q.integrate("z") - q.cumulative_integrate("z")


weight = above(-ds.attrs["gravity"][2] * m.density)
drag = above(m.sum_drag)
stress = m.stress.sel(direction="z")
error = m.stress_error.sel(direction="z")

fig, ax = plt.subplots()
for axis, sign, load in (("z", 1, weight), ("x", -1, drag)):
    (line,) = ax.plot(load, z, label="weight above" if axis == "z" else "drag above")
    ax.errorbar(
        sign * stress.sel(component=axis), z, xerr=error.sel(component=axis), fmt="o", ms=3, errorevery=5,
        color=line.get_color(), label=rf"${'-' * (sign < 0)}\sigma_{{{axis}z}}$",
    )  # fmt: skip
ax.set(xlabel="stress [Pa]", ylabel="height $z$ [mm]", xlim=(0, 50))
ax.legend()
plt.show()

bed = {"z": slice(0.002, 0.007)}
carried, load = (float(q.sel(bed).mean()) for q in (stress.sel(component="z"), weight))
shear, pulled = (float(q.sel(bed).mean()) for q in (-stress.sel(component="x"), drag))
print(f"sigma_zz: {carried:.2f} Pa, weight above {load:.2f} Pa, ratio {carried / load:.3f}")
print(f"-sigma_xz: {shear:.2f} Pa, drag above {pulled:.2f} Pa, ratio {shear / pulled:.3f}")

# %%
# The stress is that of the five steps; in a flow that is steady on average only, more of them would leave less. Where
# do grains flow? Dense suspensions do above a friction of 0.32 (Boyer et al. 2011):

friction = -stress.sel(component="x") / stress.sel(component="z")
start = m.z.sel(bed).where(friction.sel(bed) > 0.32).min()
shields = float(drag[0] / (1500 * 9.81 * 0.001))
print(f"Shields number {shields:.2f}; friction exceeds 0.32 above z = {1e3 * start:.1f} mm")
print(
    f"velocity there: {float(speed.sel(z=start)):.1e} m/s, at the top {float(speed.max()):.2f} m/s"
)

# %%
# Below that height grains do not stop at once: they creep, slower and slower with depth.
#
# **For your own data, change** the line that opens them to ``xcg.open_scene("particles.*.dump",
# contacts="contacts.*.dump", names={"v_fx": "drag"}, gravity=...)``, with the column that holds the force of the fluid
# on each grain, and the gravity less the buoyancy. With the fluid's viscosity :doc:`viscous numbers </cfd_dem>` come
# along.
