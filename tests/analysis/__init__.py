"""Tests of analyses, and configurations of hard spheres."""

from functools import cache

import numba
import numpy as np

import xcg


@numba.njit
def _sweeps(position, edge, step, sweeps, rng):
    """Move hard spheres of diameter 1 at random in a periodic cube, in place (Metropolis)."""
    count = len(position)
    trial = np.empty(3)
    for _ in range(sweeps * count):
        i = rng.integers(0, count)
        for a in range(3):
            trial[a] = (position[i, a] + step * (2 * rng.random() - 1)) % edge
        overlaps = False
        for j in range(count):
            square = 0.0
            for a in range(3):
                d = trial[a] - position[j, a]
                d -= edge * np.rint(d / edge)
                square += d * d
            if j != i and square < 1.0:
                overlaps = True
                break
        if not overlaps:
            position[i] = trial


@cache
def hard_spheres(fraction=0.3, steps=100, cells=4):
    """Return steps of an equilibrium fluid of 4 cells^3 hard spheres of diameter 1, from a crystal."""
    crystal = xcg.datasets.face_centred_cubic(cells)
    count = crystal.sizes["particle"]
    edge = (count * np.pi / 6 / fraction) ** (1 / 3)
    position = crystal.position.to_numpy()[0] * (edge / (cells * np.sqrt(2)))
    rng = np.random.default_rng(1)
    _sweeps(position, edge, 0.25, 400, rng)
    frames = []
    for _ in range(steps):
        _sweeps(position, edge, 0.25, 15, rng)
        frames.append(position.copy())
    return xcg.scene_from_arrays(
        np.array(frames),
        diameter=np.ones((steps, count)),
        density=1.0,
        species=np.broadcast_to(1 + np.arange(count) % 2, (steps, count)),
        box=[(0, edge)] * 3,
        periodic="xyz",
        time=np.arange(steps) * 1.0,
    )


def percus_yevick(k, fraction):
    """Return the structure factor of hard spheres of diameter 1 by Percus and Yevick (Wertheim 1963)."""
    a = (1 + 2 * fraction) ** 2 / (1 - fraction) ** 4
    b = -6 * fraction * (1 + fraction / 2) ** 2 / (1 - fraction) ** 4
    c = fraction * a / 2
    # -c(r) = a + b r + c r^3 inside contact; its transform by quadrature
    x, w = np.polynomial.legendre.leggauss(200)
    r, w = 0.5 * (x + 1), 0.5 * w
    k = np.asarray(k, float)[..., None]
    direct = -(4 * np.pi * w * r**2 * (a + b * r + c * r**3) * np.sinc(k * r / np.pi)).sum(axis=-1)
    return 1 / (1 - 6 * fraction / np.pi * direct)


def percus_yevick_g(fraction, r_max=3.0, step=0.005):
    """Return places r and g(r) by Percus and Yevick, from Baxter's equation as Perram (1975) solves it.

    ``r h(r) = 12 phi int_0^1 Q(t) (r - t) h(r - t) dt`` for r > 1, where h = -1 for r < 1.
    """
    n = round(1 / step)
    t = np.arange(n + 1) * step
    a, b = 1 + 2 * fraction, -1.5 * fraction
    q = 12 * fraction * (a / 2 * (t**2 - 1) + b * (t - 1)) / (1 - fraction) ** 2
    weight = step * np.where((t == 0) | (t == t[-1]), 0.5, 1.0) * q
    r = np.arange(round(r_max / step) + 1) * step
    f = np.where(r < 1, -r, 0.0)  # r h(r)
    for k in range(n, len(r)):
        before = f[k - n : k + 1][::-1].copy()
        before[0] = 0.0
        if 0 < k - n <= n:  # f jumps at contact
            before[k - n] = 0.5 * (f[n] - 1.0)
        elif k == n:
            before[0] = -1.0  # at contact itself, only values below it are in the integral
            f[k] = weight @ before
            continue
        f[k] = (weight @ before) / (1 - weight[0])
    return r[n:], 1 + f[n:] / r[n:]
