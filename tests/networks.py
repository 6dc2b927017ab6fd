"""Fabricated networks of grains with known forces, and chains as sets, for tests of force chains."""

from __future__ import annotations

import csv

import numpy as np

import xcg


def network(position, pairs, force, **options):
    """Scene of equal grains that push each other along their branches with given magnitudes."""
    x = np.zeros((len(position), 3))
    x[:, : np.shape(position)[1]] = position
    i, j = np.asarray(pairs, int).reshape(-1, 2).T
    branch = x[i] - x[j]
    length = np.linalg.norm(branch, axis=1, keepdims=True)
    given = {
        "diameter": np.ones(len(x)),
        "density": 1.0,
        "contact_i": i,
        "contact_j": j,
        "contact_force": np.reshape(force, (-1, 1)) * branch / length,
        "contact_point": 0.5 * (x[i] + x[j]),
    }
    return xcg.scene_from_arrays(x, **(given | options))


def nine_particles(across=0.2):
    """Three columns of three grains, a strong force along each column, weak ones across."""
    position = [(x, y) for x in range(3) for y in range(3)]
    along = [(3 * x + y, 3 * x + y + 1) for x in range(3) for y in range(2)]
    beside = [(3 * x + y, 3 * x + y + 3) for x in range(2) for y in range(3)]
    return network(position, along + beside, [1.0] * 6 + [across] * 6, dimension=2, thickness=1.0)


def fork():
    """A stem of three grains that parts into two arms of three, 30 degrees to either side: nine grains."""
    stem = [(0.0, float(y)) for y in range(3)]
    arms = [
        [(s * k * np.sin(np.pi / 6), 2 + k * np.cos(np.pi / 6)) for k in (1, 2, 3)] for s in (-1, 1)
    ]
    pairs = [(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (2, 6), (6, 7), (7, 8)]
    return network(
        stem + arms[0] + arms[1], pairs, [2, 2, 1.1, 1, 1, 1.1, 1, 1], dimension=2, thickness=1.0
    )


def chains_of(fc, t=0):
    """Chains of one step as a set of sets of ids."""
    step = fc.isel(time=t)
    ids = step.particle_id.values
    chain = step.chain_id.values
    return {frozenset(ids[chain == k].tolist()) for k in np.unique(chain[chain >= 0])}


def read_fcf(path):
    """Rows of a CSV of Force Chain Finder, as dicts of text."""
    with open(path, newline="") as file:
        return list(csv.DictReader(file))
