"""Tests of analyses, and the structure of hard spheres by Percus and Yevick."""

import numpy as np


def percus_yevick(k, fraction):
    """Return the structure factor of hard spheres of diameter 1 by Percus and Yevick (Wertheim 1963)."""
    a = (1 + 2 * fraction) ** 2 / (1 - fraction) ** 4
    b = -6 * fraction * (1 + fraction / 2) ** 2 / (1 - fraction) ** 4
    c = fraction * a / 2
    # -c(r) = a + b r + c r^3 inside contact; its transform by quadrature
    x, w = np.polynomial.legendre.leggauss(200)
    r = 0.5 * (x + 1)
    w = 0.5 * w
    k = np.asarray(k, float)[..., None]
    direct = -(4 * np.pi * w * r**2 * (a + b * r + c * r**3) * np.sinc(k * r / np.pi)).sum(axis=-1)
    return 1 / (1 - 6 * fraction / np.pi * direct)


def percus_yevick_g(fraction, r_max=3.0, step=0.005):
    """Return places r and g(r) by Percus and Yevick, from Baxter's equation as Perram (1975) solves it.

    ``r h(r) = 12 phi int_0^1 Q(t) (r - t) h(r - t) dt`` for r > 1, where h = -1 for r < 1.
    """
    n = round(1 / step)
    t = np.arange(n + 1) * step
    a = 1 + 2 * fraction
    b = -1.5 * fraction
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
