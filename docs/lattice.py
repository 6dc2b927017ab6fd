"""Fields at a point of a lattice against the width: python -m docs.lattice writes docs/_static/lattice.png.

The case of figure 7 of Pysammos (EGUsphere preprint 2026-2591): a face-centred cubic lattice of grains between two
plates, of which the upper one moves down, seen at its centre. The paper gives neither its data nor its numbers; so the
lattice is strained uniformly, and every field has a closed form.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
import xarray as xr
from scipy.spatial import cKDTree

import xcg
from docs.kernels import COLOURS, KERNELS, second_moment
from tests.identities.scenes import load

mpl.use("agg")
from matplotlib import pyplot as plt

STATIC = Path(__file__).parent / "_static"
DATA = Path(__file__).parents[1] / "tests" / "data"
DIAMETER, DENSITY, STIFFNESS = 0.02, 2500.0, 1e4  # m, kg m-3, N m-1
POINT = (0.0, 0.0, 0.42725)
OFFSET = (0.23, 0.41, 0.0)  # of the lattice across, in layers, and its turn about z: by neither the
TURN = np.deg2rad(20)  # point nor the axes are special
LAYERS = 60  # whose height between plates is twice that of the point
STRAIN, RATE = 1e-3, 0.01  # of the height, and its rate (s-1)
LARGEST = 6  # w / d
WIDTHS = np.geomspace(0.5, LARGEST, 22)
RULE = (0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0)  # w / d of the rule that finds contacts by centres
BONDS = np.array([[1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]]) / np.sqrt(2)  # those that shorten
FORCE = STIFFNESS * DIAMETER * (1 - np.sqrt(0.5 + 0.5 * (1 - STRAIN) ** 2))


def lattice() -> xr.Dataset:
    """Return the strained lattice, wide enough for the largest Gaussian to see no edge."""
    across = int(np.ceil((3 * LARGEST + 1) * 2))
    step = DIAMETER / np.sqrt(2)
    index = np.indices((2 * across + 1, 2 * across + 1, LAYERS)).reshape(3, -1).T
    index = index[index.sum(axis=1) % 2 == 0] - [across, across, 0]
    reference = step * (index + OFFSET) + [0, 0, DIAMETER / 2]
    across_x = [np.cos(TURN), np.sin(TURN), 0]
    across_y = [-np.sin(TURN), np.cos(TURN), 0]
    reference = reference @ np.array([across_x, across_y, [0, 0, 1]])
    near = np.abs(reference - POINT).max(axis=1) < (3 * LARGEST + 1.5) * DIAMETER
    position = reference[near]
    position[:, 2] *= 1 - STRAIN
    velocity = np.zeros_like(position)
    velocity[:, 2] = -RATE * position[:, 2]
    pairs = cKDTree(position).query_pairs(
        DIAMETER * (1 - STRAIN / 10), output_type="ndarray"
    )  # not those of one layer, which only touch
    branch = position[pairs[:, 0]] - position[pairs[:, 1]]
    return xcg.scene_from_arrays(
        position,
        diameter=DIAMETER,
        density=DENSITY,
        velocity=velocity,
        contact_i=pairs[:, 0],
        contact_j=pairs[:, 1],
        contact_force=FORCE * branch / np.linalg.norm(branch, axis=1, keepdims=True),
    )


def exact() -> dict[str, float]:
    """Return the fields of the infinite lattice, but for the kinetic stress."""
    count = np.sqrt(2) / DIAMETER**3 / (1 - STRAIN)  # grains per volume
    bonds = DIAMETER * BONDS * [1, 1, 1 - STRAIN]
    pull = FORCE * bonds / np.linalg.norm(bonds, axis=1, keepdims=True)
    stress = count * np.einsum("ci,cj->ij", pull, bonds)
    return {
        "volume_fraction": count * np.pi / 6 * DIAMETER**3,
        "velocity": -RATE * POINT[2],
        "pressure": float(np.trace(stress)) / 3,
        "contact_stress": float(stress[2, 2]),
        "stress_ratio": 0.0,
    }


def at_point(ds: xr.Dataset, kernel: str, width: float) -> dict[str, float]:
    """Return the fields at the point: those of `exact`, and the kinetic stress."""
    names = ["volume_fraction", "velocity", "pressure", "contact_stress", "kinetic_stress"]
    f = ds.cg.coarse_grain(
        names, kernel=kernel, width=width, axes="", at=dict(zip("xyz", POINT, strict=True))
    ).isel(time=0)
    vertical = {"component": "z", "direction": "z"}
    contact = f.contact_stress
    return {
        "volume_fraction": f.volume_fraction.item(),
        "velocity": f.velocity.sel(component="z").item(),
        "pressure": f.pressure.item(),
        "contact_stress": contact.sel(vertical).item(),
        "stress_ratio": float(contact.sel(component="x", direction="y") / contact.sel(vertical)),
        "kinetic_stress": f.kinetic_stress.sel(vertical).item(),
    }


def by_centres(ds: xr.Dataset, kernel: xcg.Kernel, beyond: float = 0.0) -> float:
    """Return the vertical contact stress if only grains with their centre in the support are asked for contacts.

    This is the rule of Pysammos 1.0.0, as its paper says; each half of a branch by 64 Gauss points. Grains with their
    centre up to `beyond` outside of the support are asked, too.
    """
    x, weights = np.polynomial.legendre.leggauss(64)
    step = ds.isel(time=0)
    position = step.position.values - POINT
    total = 0.0
    for own, other, sign in (("contact_i", "contact_j", 1), ("contact_j", "contact_i", -1)):
        rows = step[own].values.astype(int)
        inside = np.linalg.norm(position[rows], axis=1) < kernel.cutoff + beyond
        centre = position[rows[inside]]
        half = (centre - position[step[other].values.astype(int)[inside]]) / 2
        force = sign * step.contact_force.values[inside, 2]
        share = np.zeros(len(half))
        for s, weight in zip((x + 1) / 2, weights / 2, strict=True):
            share += weight * kernel.value(np.linalg.norm(centre - s * half, axis=1), seen=3)
        total += float((share * force * half[:, 2]).sum())
    return total


@dataclass(frozen=True)
class Printed:
    """What another program printed for a node of its scene, and how xcg gets there."""

    program: str
    scene: xr.Dataset
    kernel: Callable[[float], xcg.Kernel]  # of a width
    width: float
    node: dict[str, float]
    fields: dict[str, float]

    def sweep(self, widths: np.ndarray) -> dict[str, np.ndarray]:
        """Return the same fields of xcg over widths."""
        rows = [self._fields(width) for width in widths]
        return {name: np.array([row[name] for row in rows]) for name in self.fields}

    def _fields(self, width: float) -> dict[str, float]:
        f = self.scene.cg.coarse_grain(
            list(self.fields), kernel=self.kernel(width), axes="", at=self.node
        ).isel(time=0)
        return {
            "volume_fraction": f.volume_fraction.item(),
            "contact_stress": f.contact_stress.sel(component="z", direction="z").item(),
        }


def mercury() -> Printed:
    """Return the node in the middle of the synthetic scene that MercuryCG evaluated."""
    reference = json.loads((DATA / "mercury_synthetic" / "reference_lucy.json").read_text())
    (case,) = (c for c in reference["cases"] if "-coordinates XYZ " in c["command"])
    node = case["nodes"][2]
    printed = dict(zip(reference["columns"], node["values"], strict=True))
    return Printed(
        "MercuryCG",
        load("mercury_synthetic").ds,
        lambda width: xcg.Lucy(width, dimension=3),
        float(case["header"].split("width")[1].split()[0]) / 2,  # its width is the cutoff
        dict(zip("xyz", node["coords"], strict=True)),
        {
            "volume_fraction": printed["VolumeFraction"],
            "contact_stress": printed["ContactStressZZ"],
        },
    )


def lammps() -> Printed:
    """Return a bin within the flow that LAMMPS' compute continuum/chunk evaluated."""
    folder = DATA / "lammps_continuum"
    chute = xcg.open_scene(
        folder / "particles.*.gz", contacts=folder / "contacts.*.gz", frozen=2
    ).load()
    table = np.loadtxt(folder / "fields_3d.txt.gz")
    bins = np.stack(np.unravel_index(table[:, 0].astype(int) - 1, (20, 10, 35)), axis=1)
    row = int(np.flatnonzero((table[:, 3] > 0.5) & (bins[:, 2] > 10))[0])
    centre = bins[row] + 0.5 + chute.box.values[0, :, 0]
    return Printed(
        "LAMMPS",
        chute,
        lambda width: xcg.Gaussian(width, shifted=True, dimension=3),
        0.5,
        dict(zip("xyz", centre.tolist(), strict=True)),
        # tension is positive there
        {"volume_fraction": table[row, 3], "contact_stress": -table[row, 18]},
    )


PANELS = {
    "volume_fraction": r"volume fraction $\phi$",
    "velocity": r"vertical velocity $V_z$ [mm/s]",
    "pressure": "pressure [kPa]",
    "contact_stress": r"contact stress $\sigma^c_{zz}$ [kPa]",
    "stress_ratio": r"stress ratio $\sigma^c_{xy} / \sigma^c_{zz}$",
    "kinetic_stress": r"kinetic stress $\sigma^k_{zz}$ [mPa]",
}
SCALES = {"velocity": 1e3, "pressure": 1e-3, "contact_stress": 1e-3, "kinetic_stress": 1e3}


def draw_lattice(axes: np.ndarray) -> None:
    """Draw each field over w/d for the three kernels, its closed form, and the rule by centres."""
    ds = lattice()
    closed = exact()
    panels = dict(zip(PANELS, axes.flat, strict=True))
    density = closed["volume_fraction"] * DENSITY
    for kind, colour in zip(KERNELS, COLOURS, strict=True):
        name = kind.__name__
        rows = [at_point(ds, name.lower(), w * DIAMETER) for w in WIDTHS]
        for field, ax in panels.items():
            values = np.array([row[field] for row in rows]) * SCALES.get(field, 1.0)
            ax.plot(WIDTHS, values, color=colour, label=name)
        spread = second_moment(kind(1.0, dimension=3)) * (WIDTHS * DIAMETER) ** 2
        flow = density * RATE**2 * spread * SCALES["kinetic_stress"]
        panels["kinetic_stress"].plot(WIDTHS, flow, "k--", lw=0.8)
        kernels = [kind(w * DIAMETER, dimension=3) for w in RULE]
        rule = np.array([by_centres(ds, kernel) for kernel in kernels])
        label = f"{name}, contacts by centres"
        panels["contact_stress"].plot(RULE, rule * 1e-3, "^", color=colour, ms=5, label=label)
        errors = [row["contact_stress"] / closed["contact_stress"] - 1 for row in rows]
        print(f"{name}: contact stress off by at most {np.abs(errors).max():.1e} from w/d = 0.5,")
        far = np.abs(errors)[WIDTHS >= 3].max()
        print(f"  {far:.1e} from w/d = 3; by centres {rule / closed['contact_stress'] - 1}")
        ratios = np.abs([row["stress_ratio"] for row in rows])
        print(f"  stress ratio at most {ratios.max():.1e}, {ratios[WIDTHS >= 3].max():.1e} from 3")
    for field, value in closed.items():
        panels[field].axhline(value * SCALES.get(field, 1.0), color="black", ls="--", lw=0.8)
    panels["kinetic_stress"].set_yscale("log")
    for letter, (field, ax) in zip("abcdef", panels.items(), strict=True):
        ax.set_title(f"({letter}) {PANELS[field]}", fontsize="medium", loc="left")
        ax.set(xscale="log", xlabel="$w / d$")
        ax.set_xticks(RULE, [f"{w:g}" for w in RULE])
        ax.minorticks_off()
    panels["contact_stress"].legend(fontsize="x-small")
    handles = [mpl.lines.Line2D([], [], color="k", ls="--", lw=0.8, label="closed form")]
    handles += panels["volume_fraction"].get_lines()[:3]
    panels["volume_fraction"].legend(handles=handles, fontsize="small")


def draw_printed(ax: plt.Axes, letter: str, printed: Printed) -> None:
    """Draw two fields of xcg at a node over the width, divided by what the program printed for its width."""
    widths = printed.width * np.geomspace(0.6, 3, 25)
    same = printed.sweep(np.array([printed.width]))
    for name, values in printed.sweep(widths).items():
        ax.plot(widths / printed.width, values / printed.fields[name], label=name.replace("_", " "))
        ratio = float(same[name][0]) / printed.fields[name] - 1
        print(f"{printed.program}, {name}: {printed.fields[name]:.6g}, xcg differs by {ratio:.1e}")
    ax.plot(1.0, 1.0, "ko", ms=7, mfc="none", label=f"printed by {printed.program}")
    ax.set_title(
        f"({letter}) xcg at a node, over the value of {printed.program}",
        fontsize="medium",
        loc="left",
    )
    ax.set_xlabel(f"width over that of {printed.program}, $w / w_0$")
    ax.legend(fontsize="small")


def main() -> None:
    """Draw the lattice, and nodes that other programs evaluated."""
    figure, axes = plt.subplots(3, 3, figsize=(12, 10), layout="constrained")
    axes[2, 2].axis("off")
    draw_lattice(axes[:2])
    draw_printed(axes[2, 0], "g", mercury())
    draw_printed(axes[2, 1], "h", lammps())
    figure.savefig(STATIC / "lattice.png", dpi=90)


if __name__ == "__main__":
    main()
