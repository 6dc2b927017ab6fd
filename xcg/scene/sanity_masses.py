"""Checks that masses, sizes, densities and the dimension of a scene agree, and arguments with them.

Each returns a message, or None.
"""

from __future__ import annotations

import numpy as np

from xcg.scene.complete import superquadric_integrals
from xcg.scene.sanity_sample import FEW, Particles
from xcg.scene.schema import COMPONENTS, Setup

_SAME = 2e-3  # scatter of masses over d^2, from sizes and masses of four digits
_SHAPE = 0.02  # error of volumes of half-axes and exponents of three digits
_DIGITS = 5e-3  # error of products of masses, sizes and densities of three digits
_VARIED = 0.02  # scatter of diameters by which d^2 and d^3 differ
_FLAT_BOX = 3.0  # diameters: a thinner box is meant as the thickness of a layer
_DENSITIES = (100.0, 30_000.0)  # kg m-3
_LARGE = 0.05  # m; larger grains of another density are of scaled data, most likely


def _contradiction(grains: Particles) -> str | None:
    """Check that masses are densities times volumes."""
    if not {"mass", "diameter", "volume", "density"} <= set(grains.frame):
        return None
    sample = grains.sample
    mass = sample["mass"]
    volume = sample["volume"]
    density = sample["density"]
    d = sample["diameter"]
    expected = density * volume
    wrong = np.flatnonzero((np.abs(mass - expected) > _DIGITS * expected) & (mass > 0))
    if not wrong.size:
        return None
    index = wrong[0]
    numbers = (
        f"{wrong.size} of {len(mass)} particles looked at, such as id {sample['particle_id'][index]}: mass "
        f"{mass[index]:.6g}, density {density[index]:.6g}, diameter {d[index]:.6g}, volume {volume[index]:.6g}"
    )
    thickness = mass / (density * np.pi / 4 * d**2)
    depth = thickness.mean()
    varied = np.std(d) > _VARIED * np.mean(d)
    # of equal grains only a thickness of 1 shows discs, which two-dimensional simulations have
    is_one = abs(depth / grains.setup.scales[0] - 1) < _SAME
    if np.std(thickness) < _SAME * depth and (varied or is_one):
        return (
            f"masses fit discs of thickness {depth:.4g}, m = rho pi r^2 times that, and volumes do not ({numbers}): "
            f"give shape='disc' and thickness={depth:.4g}{_with_dimension(grains.setup)}"
        )
    return (
        f"masses are not density times volume ({numbers}): check the units of these columns, or drop one of them, "
        "such as names={'density': None}"
    )


def _massless(grains: Particles) -> str | None:
    """Check that some grains have a mass."""
    if "mass" not in grains.sample or grains.frame["mass"].any() or not grains.count:
        return None
    return (
        f"all {grains.count} grains have the mass 0, so that densities are 0, and velocities and temperatures NaN: "
        "name the right column, or drop this one, names={'mass': None}, and give density="
    )


def _volumes_of_shapes(grains: Particles) -> str | None:
    """Check that volumes agree with ellipsoids or superquadrics of the half-axes."""
    sample = grains.sample
    axes = [f"half_axis_{axis}" for axis in COMPONENTS]
    if not {"volume", *axes} <= set(sample):
        return None
    volume, _, _ = superquadric_integrals(
        sample.get("exponent_1", 2.0), sample.get("exponent_2", 2.0)
    )
    for name in axes:
        volume = volume * sample[name]
    ratio = float(np.median(sample["volume"] / volume))
    if abs(ratio - 1) <= _SHAPE:
        return None
    way_out = "check the units of the columns, or drop the wrong one, names={'column': None}"
    if abs(ratio / 8 - 1) <= _SHAPE:
        way_out = "the columns of whole axes hold half-axes: map them, names={'shapex': 'half_axis_x', ...}"
    elif abs(ratio * 8 - 1) <= _SHAPE:
        way_out = "the columns of half-axes hold whole axes: map them, names={'shapex': 'whole_axis_x', ...}"
    return (
        f"volumes, or masses over densities, are {ratio:.4g} times those of the half-axes (the median; in the first "
        f"row {sample['volume'][0]:.6g}, and {axes[0]} is {sample[axes[0]][0]:.6g}): {way_out}"
    )


def _with_dimension(setup: Setup) -> str:
    return " and dimension=2" if setup.dimension == 3 else ""


def _large_volumes(grains: Particles) -> str | None:
    """Check that volumes do not exceed pi d^3 / 6."""
    named = {"diameter", "volume", "mass"} <= set(grains.frame)
    if not named or grains.setup.shape != "sphere" or "half_axis_x" in grains.frame:
        return None
    d = grains.sample["diameter"]
    volume = grains.sample["volume"]
    ratio = np.median(volume / (np.pi / 6 * d**3))
    if ratio <= 1 + _DIGITS:
        return None
    # of grains with an axis, such as rods, the diameter is that across it, unless it is a radius
    is_oriented = not {"director", "quat_w"}.isdisjoint(grains.frame)
    if is_oriented and abs(ratio - 8) > 8 * _DIGITS:
        return None
    return (
        f"volumes are {ratio:.4g} times those of spheres with the diameters (the median; in the first row volume "
        f"{volume[0]:.6g} and diameter {d[0]:.6g}): a column holds radii in place of diameters or has another "
        "unit, or grains are discs (shape='disc', thickness=). Drop the wrong column, names={'column': None}"
    )


def _discs(grains: Particles) -> str | None:
    """Check that masses of spheres do not go with the square of the diameter."""
    if not {"mass", "diameter", "volume"} <= set(grains.frame) or grains.setup.shape != "sphere":
        return None
    d = grains.sample["diameter"]
    volume = grains.sample["volume"]
    varied = len(d) >= FEW and np.std(d) >= _VARIED * np.mean(d)
    if not varied or not np.allclose(volume, np.pi / 6 * d**3, rtol=1e-6, atol=0):
        return None
    over_square = grains.sample["mass"] / d**2
    if np.std(over_square) >= _SAME * np.mean(over_square):
        return None
    return (
        "masses go with the square of the diameter, as those of discs, and volumes and densities are taken to be "
        f"those of spheres: give shape='disc' and thickness={_with_dimension(grains.setup)}"
    )


def _layer(grains: Particles) -> str | None:
    """Check that the grains of a volume do not all lie in a plane, and that a layer lies in its plane.

    A box of at most three diameters across the plane is the layer's thickness.
    """
    if grains.count < FEW:
        return None
    position = grains.frame["position"]
    nearly = np.flatnonzero(np.ptp(grains.sample["position"], axis=0) == 0)
    flat = [int(k) for k in nearly if not np.ptp(position[:, k])]
    plane = "".join(COMPONENTS[k] for k in range(3) if k not in flat)
    if grains.setup.dimension == 2:
        (across,) = {0, 1, 2} - {*grains.setup.axes}
        depth = np.ptp(position[:, across])
        if not depth > max(_FLAT_BOX * grains.diameter, grains.setup.thickness or 0.0):
            return None
        way = f"give plane={plane!r}" if len(flat) == 1 else "leave dimension=2 out"
        return (
            f"the scene is one layer in the plane {grains.setup.plane!r}, and grains are up to {depth:.4g} apart "
            f"across it: {way}, or select the grains of one layer"
        )
    if grains.is_volume or len(flat) != 1:
        return None
    low, high = grains.edges.get(flat[0], (-np.inf, np.inf))
    if high - low <= _FLAT_BOX * grains.diameter:
        return None
    named = "" if plane == "xy" else f", plane={plane!r}"
    return (
        f"all {grains.count} grains have {COMPONENTS[flat[0]]} = {position[0, flat[0]]:g}, and the scene is taken as "
        f"three-dimensional: give dimension=2{named} if it is one layer, with thickness= where volumes matter"
    )


def _density_in_si(grains: Particles) -> str | None:
    """Check that small grains of a scene in SI units have a density of a solid."""
    if grains.setup.unit_system != "SI" or "density" not in grains.frame:
        return None
    densities = grains.sample["density"]
    # grains without mass have none, and one of 1 is of scaled data
    densities = densities[(densities > 0) & (densities != 1)]
    if len(densities) < FEW or not grains.diameter < _LARGE:
        return None
    density = float(np.median(densities))
    low, high = _DENSITIES
    if low <= density <= high:
        return None
    return (
        f"the density of the grains is {density:.4g} kg m-3 (the median), and solids have {low:g} to {high:,.0f}; the "
        f"mean diameter is {grains.diameter:.4g} m: check the units of masses, sizes and density, and give factors "
        "to SI, such as units={'length': 1e-3}, or units='reduced' for scaled data"
    )


def _unused_density(grains: Particles) -> str | None:
    """Check that the data hold no masses or densities other than density=."""
    argument = grains.setup.density
    if argument is None:
        return None
    if "density" not in grains.frame:
        if "mass" not in grains.frame:
            return None
        return (
            f"density={argument:g} is not used, as the data hold masses and no sizes: leave it out, or give "
            "sizes, a column or diameter="
        )
    density = grains.sample["density"]
    if np.abs(density / argument - 1).max() <= _DIGITS:
        return None
    return (
        f"density={argument:g} is not used, as the data hold masses or densities (densities are "
        f"{density.min():.6g} to {density.max():.6g}): leave it out, or drop these columns, "
        "names={'mass': None, 'density': None}"
    )


def _unused_size(grains: Particles) -> str | None:
    """Check that the data hold no diameters or masses other than diameter= and mass=."""
    for name in ("diameter", "mass"):
        argument = getattr(grains.setup, name)
        if argument is None or name not in grains.frame:
            continue
        values = grains.sample[name]
        if np.abs(values / argument - 1).max() > _DIGITS:
            return (
                f"{name}={argument:g} is not used, as the data hold others ({values.min():.6g} to "
                f"{values.max():.6g}): leave it out, or drop their column, names={{'column': None}}"
            )
    return None


OF_MASSES = (
    _massless,
    _contradiction,
    _volumes_of_shapes,
    _large_volumes,
    _discs,
    _layer,
    _density_in_si,
)
OF_ARGUMENTS = (_unused_density, _unused_size)
