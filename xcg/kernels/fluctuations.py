"""Second moments of the velocity about a linear field of velocities, expanded in the sums of each phase."""

import numpy as np

from xcg.kernels._jit import jit


@jit
def about_linear(mass, momentum, kinetic, offset, shear, spread, drift, mean, gradient, unknown, out):
    """Sum of m Psi v'' v'' with v'' = u - b - G (x - x_bar): about the bulk's velocity at the place of each grain.

    Parameters
    ----------
    mass : (p, n)
        Sum of m Psi of each phase at each node.
    momentum : (3, p, n)
        Sum of m Psi u.
    kinetic : (3, 3, p, n)
        Sum of m Psi u u.
    offset : (3, p, n)
        Sum of m Psi x.
    shear, spread : (3, 3, p, n)
        Sums of m Psi u x and m Psi x x.
    drift, mean : (3, n)
        b and x_bar of the bulk; zero is taken where b is NaN.
    gradient : (3, 3, n)
        G of the bulk.
    unknown : (n,)
        Where the result is NaN.
    out : (3, 3, p, n)
        Written.
    """
    b, gx, rest = np.zeros(3), np.zeros(3), np.zeros(3)
    g, gm, mixed = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    for n in range(mass.shape[1]):
        if unknown[n]:
            out[:, :, :, n] = np.nan
            continue
        for i in range(3):
            b[i] = 0.0 if np.isnan(drift[i, n]) else drift[i, n]
            for j in range(3):
                g[i, j] = gradient[i, j, n]
                b[i] -= g[i, j] * mean[j, n]
        for p in range(mass.shape[0]):
            for i in range(3):
                gx[i] = g[i, 0] * offset[0, p, n] + g[i, 1] * offset[1, p, n] + g[i, 2] * offset[2, p, n]
                rest[i] = gx[i] - momentum[i, p, n]
                for j in range(3):
                    gm[i, j] = (
                        g[i, 0] * spread[0, j, p, n] + g[i, 1] * spread[1, j, p, n] + g[i, 2] * spread[2, j, p, n]
                    )
            for i in range(3):
                for j in range(3):
                    mixed[i, j] = b[i] * rest[j] - (
                        shear[i, 0, p, n] * g[j, 0] + shear[i, 1, p, n] * g[j, 1] + shear[i, 2, p, n] * g[j, 2]
                    )
            for i in range(3):
                for j in range(i, 3):
                    total = kinetic[i, j, p, n] + mass[p, n] * b[i] * b[j] + mixed[i, j] + mixed[j, i]
                    total += gm[i, 0] * g[j, 0] + gm[i, 1] * g[j, 1] + gm[i, 2] * g[j, 2]
                    out[i, j, p, n] = out[j, i, p, n] = total
