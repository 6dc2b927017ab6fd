"""Kernels: norms, marginals, gradients and segment integrals against quadrature; the promise of rtol."""

import math
import re
from itertools import pairwise
from typing import get_args

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.special import erf

import xcg
from tests.brute_force import BruteKernel
from tests.loops import compiled, uncompiled
from xcg.compiled import polynomials
from xcg.compiled.lines import has_shells
from xcg.compiled.polynomials import closed_for
from xcg.compiled.segments import RULES
from xcg.compiled.smoothing import SHELLS
from xcg.fields.sums.kernels import KernelName, kernel_of
from xcg.fields.sums.quadrature import gauss_limits

NAMES = get_args(KernelName)
SPHERE = {1: 2.0, 2: 2 * np.pi, 3: 4 * np.pi}
SEEN = [(k, m) for k in (1, 2, 3) for m in (1, 2, 3) if m <= k]


def wendland(q):
    return (1 - q) ** 4 * (1 + 4 * q)


def cubic_spline(q):
    return np.where(q < 0.5, 1 - 6 * q**2 + 6 * q**3, 2 * (1 - q) ** 3)


def quintic_spline(q):
    return (1 - q) ** 5 - 6 * np.maximum(0.0, 2 / 3 - q) ** 5 + 15 * np.maximum(0.0, 1 / 3 - q) ** 5


def narrow_gaussian(q):
    return np.exp(-12.5 * q**2)


def short(q):
    """Zero from three quarters of the cutoff on."""
    return np.maximum(0.0, 1 - (q / 0.75) ** 2) ** 3


def bump(q):
    """Smooth, but not analytic at the rim: too many polynomials would be needed for shells."""
    return np.exp(-1 / (1 - q**2))


@pytest.fixture(scope="module", autouse=True)
def _registered():
    """Register the kernels when the first test runs: each takes a tenth of a second or more."""
    xcg.register_kernel("wendland", wendland, ratio=2.0, smoothness=2)
    xcg.register_kernel("cubic spline", cubic_spline, ratio=2.0, smoothness=2)
    xcg.register_kernel("quintic spline", quintic_spline, ratio=2.0, smoothness=4)
    xcg.register_kernel("narrow gaussian", narrow_gaussian, ratio=5.0, smoothness=-1)
    xcg.register_kernel("short", short, ratio=2.0, smoothness=2)
    xcg.register_kernel("bump", bump, ratio=2.0, smoothness=2)


@pytest.mark.parametrize("name", [*NAMES, "wendland"])
@pytest.mark.parametrize(("dimension", "seen"), SEEN)
def test_kernels_and_marginals_integrate_to_one(name, dimension, seen):
    kernel = kernel_of(name, 0.7, {}, dimension)
    total = quad(
        lambda r: SPHERE[seen] * r ** (seen - 1) * kernel.value(r, seen).item(),
        0,
        kernel.cutoff,
        limit=200,
    )[0]
    assert total == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize(
    ("name", "dimension", "share"),
    [("lucy", 3, 1 / 3), ("lucy", 2, 5 / 14), ("heaviside", 3, 1 / 5), ("heaviside", 2, 1 / 4)],
)
def test_second_moments_of_kernels_and_their_marginals(name, dimension, share):
    """A parabola is smeared by half of its curvature times the second moment, which marginals keep."""
    kernel = kernel_of(name, 0.7, {}, dimension)
    for seen in range(1, dimension + 1):
        assert kernel.second_moment(seen) == pytest.approx(share * 0.7**2, rel=1e-4)


def test_constants_equal_those_of_the_theory_sheet():
    w, c = 0.7, 1.4
    assert xcg.Lucy(w, dimension=3).value(0.0) == pytest.approx(105 / (16 * np.pi * c**3))
    assert xcg.Lucy(w, dimension=2).value(0.0) == pytest.approx(5 / (np.pi * c**2))
    assert xcg.Lucy(w, dimension=1).value(0.0) == pytest.approx(5 / (4 * c))
    assert xcg.Heaviside(w, dimension=2).value(0.0) == pytest.approx(1 / (np.pi * w**2))
    # a Gaussian cut at 3 w holds 0.970709 of its mass, and its edge is 1.1 % of its peak
    whole = (2 * np.pi * w**2) ** -1.5
    assert xcg.Gaussian(w, dimension=3).value(0.0) == pytest.approx(whole / 0.970709, rel=1e-6)
    assert xcg.Gaussian(w).value(3 * w * (1 - 1e-12)) / xcg.Gaussian(w).value(0.0) == pytest.approx(
        0.0111, rel=1e-2
    )


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("dimension", "seen"), [(3, 2), (3, 1), (2, 1)])
def test_marginals_are_integrals_over_the_other_axes(name, dimension, seen):
    kernel = kernel_of(name, 0.7, {}, dimension)
    r = np.linspace(0, 0.999 * kernel.cutoff, 23)
    expected = BruteKernel(name, 0.7, dimension, seen)(r)
    np.testing.assert_allclose(kernel.value(r, seen), expected, atol=1e-12 * expected[0])


def test_the_1d_lucy_is_not_the_marginal_of_the_3d_one():
    r = np.linspace(0, 1, 11)
    marginal = xcg.Lucy(1.0, dimension=3).value(r, 1)
    own = xcg.Lucy(1.0, dimension=1).value(r)
    assert np.abs(marginal - own).max() > 0.05 * own.max()


def test_the_marginal_of_lucy_keeps_its_digits_up_to_the_rim():
    """Relative to each value, however small: near the rim a node may see nothing else."""
    nodes, weights = np.polynomial.legendre.leggauss(300)
    q = np.concatenate(
        [np.geomspace(1e-3, 0.1, 5), np.linspace(0.15, 0.95, 33), 1 - np.geomspace(1e-3, 0.04, 9)]
    )[:, None]
    half = np.sqrt((1 - q) * (1 + q))
    top = np.arcsinh(half / q)
    u = top * (1 + nodes) / 2
    s = q * np.sinh(u)
    rest = (half - s) * (half + s)  # 1 - r^2, without cancellation
    r = np.sqrt(1 - rest)
    p = rest / (1 + r)
    lucy = xcg.Lucy(cutoff=1.0, dimension=3)
    peak = 105 / (16 * np.pi)
    for got, along in (
        (lucy.value(q[:, 0], 2), p**3 * (1 + 3 * r)),
        (lucy.derivative(q[:, 0], 2), -12 * q * p**2),
    ):
        expected = peak * (top * along * q * np.cosh(u) * weights).sum(axis=1)
        np.testing.assert_allclose(got, expected, rtol=2e-13)


@pytest.mark.parametrize("name", ["lucy", "shifted gaussian", "wendland"])
@pytest.mark.parametrize(("dimension", "seen"), SEEN)
def test_derivatives_equal_finite_differences(name, dimension, seen):
    kernel = kernel_of(name, 0.7, {}, dimension)
    r = np.linspace(0.02, 0.98, 31) * kernel.cutoff
    h = 1e-4
    v = [kernel.value(r + k * h, seen) for k in (-2, -1, 1, 2)]
    slope = (8 * (v[2] - v[1]) - (v[3] - v[0])) / (12 * h)
    # the marginals of a registered kernel have logarithms at r = 0, where their series converge slowly
    tolerance = 2e-7 if name == "wendland" else 2e-9
    np.testing.assert_allclose(
        kernel.derivative(r, seen), slope, atol=tolerance * np.abs(slope).max()
    )


@pytest.mark.parametrize("ratio", [0.01, 0.5, 1.41, 1.42, 3.0, 6.0])
@pytest.mark.parametrize(("dimension", "seen"), SEEN)
def test_shifted_gaussians_of_any_cutoff(dimension, seen, ratio):
    """Continuous at the cutoff, with an integral of 1, however wide or narrow it is."""
    kernel = xcg.Gaussian(0.7, cutoff=0.7 * ratio, dimension=dimension, shifted=True)
    total = quad(
        lambda r: SPHERE[seen] * r ** (seen - 1) * kernel.value(r, seen).item(), 0, kernel.cutoff
    )[0]
    assert total == pytest.approx(1.0, rel=1e-9)
    assert abs(kernel.value((1 - 1e-9) * kernel.cutoff, seen)) < 1e-8 * kernel.value(0.0, seen)
    assert kernel.value(kernel.cutoff, seen) == 0.0


@pytest.mark.parametrize("shifted", [False, True])
@pytest.mark.parametrize("ratio", [0.5, 1.0, 3.0, 6.0])
@pytest.mark.parametrize("seen", [3, 2, 1])
def test_gaussians_are_their_closed_forms(seen, ratio, shifted):
    """Values to 2e-12 of the largest, derivatives to 1e-9 of this over the cutoff, in codimensions 0, 1 and 2."""
    kernel = xcg.Gaussian(1.0, cutoff=ratio, dimension=3, shifted=shifted)
    r = ratio * np.linspace(0, 1, 401)[:-1]
    rest2 = ratio**2 - r**2  # of half the chord
    edge = np.exp(-0.5 * ratio**2) if shifted else 0.0
    bell = np.exp(-0.5 * r**2)
    if seen == 3:
        value = -bell * np.expm1(-0.5 * rest2) if shifted else bell
        slope = -r * bell
    elif seen == 2:
        line = np.sqrt(2 * np.pi) * bell * erf(np.sqrt(rest2 / 2))
        value = line - 2 * np.sqrt(rest2) * edge
        # without what the jump at the cutoff adds
        slope = -r * line
    else:
        value = -2 * np.pi * bell * np.expm1(-0.5 * rest2) - np.pi * rest2 * edge
        slope = -2 * np.pi * r * (-bell * np.expm1(-0.5 * rest2) if shifted else bell)
    scale = kernel.value(0.0, seen) / value[0]
    largest = scale * value[0]
    found = kernel.value(r, seen)
    np.testing.assert_allclose(found, scale * value, rtol=0, atol=2e-12 * largest)
    steepest = np.abs(scale * slope).max()
    found = kernel.derivative(r, seen)
    error = 1e-9 * (steepest + largest / ratio)
    np.testing.assert_allclose(found, scale * slope, rtol=0, atol=error)


@pytest.mark.parametrize("shifted", [False, True])
@pytest.mark.parametrize("ratio", [0.5, 3.0, 5.0])
def test_sums_in_a_volume_take_a_gaussian_to_rounding(ratio, shifted):
    """Of one grain, at any distance: a polynomial of the squared distance, or a table for far cutoffs."""
    ds = xcg.scene_from_arrays(position=np.zeros((1, 3)), diameter=1.0, mass=1.0, species=[1])
    kernel = xcg.Gaussian(cutoff=1.0, width=1.0 / ratio, dimension=3, shifted=shifted)
    r = np.linspace(0.0, 1.1, 401)
    at = {a: xr.DataArray(r * n, dims="p") for a, n in zip("xyz", (0.48, 0.6, 0.64), strict=True)}
    found = ds.cg.coarse_grain("density", at=at, kernel=kernel).density.values.ravel()
    bell = np.exp(-0.5 * (ratio * r) ** 2)
    exact = np.where(r < 1.0, bell - np.exp(-0.5 * ratio**2) * shifted, 0.0)
    exact *= kernel.value(0.0) / exact[0]
    inside = np.abs(r - 1.0) > 1e-9
    np.testing.assert_allclose(found[inside], exact[inside], rtol=0, atol=1e-14 * exact[0])


def test_a_gaussian_cut_where_it_has_no_digits_raises():
    with pytest.raises(ValueError, match="cutoff=7: expected a cutoff of at most 6 w"):
        xcg.Gaussian(1.0, cutoff=7.0)


def test_the_shifted_gaussian_is_the_gaussian_less_its_value_at_the_cutoff():
    r = np.linspace(0, 2.0, 30)
    whole = xcg.Gaussian(0.7)
    shifted = xcg.Gaussian(0.7, shifted=True)
    expected = np.exp(-0.5 * (r / 0.7) ** 2) - np.exp(-4.5)
    found = shifted.value(r) / shifted.value(0.0) * (1 - np.exp(-4.5))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-15)
    assert repr(shifted) == "Gaussian(width=0.7, cutoff=2.1, shifted=True)"
    assert (shifted.name, shifted.smoothness, shifted.differentiable) == (
        "shifted gaussian",
        0,
        False,
    )
    assert (whole.name, whole.smoothness) == ("gaussian", -1)
    assert kernel_of("Shifted Gaussian", 0.7, {}, 3).in_dimension(2).shifted


def segments(dimension):
    """Points about segments: on the line, beside it, at its ends, far away; long, short and of no length."""
    rng = np.random.default_rng(0)
    axis = np.eye(dimension)[0]
    for length in (0.0, 1e-9, 1e-3, 0.3, 1.0, 5.0):
        direction = axis if length == 1.0 else rng.normal(size=dimension)
        direction /= np.linalg.norm(direction)
        end = length * direction
        along = np.outer(np.linspace(-1, 2, 13) * max(length, 0.5), direction)
        beside = rng.uniform(-2, 2, (40, dimension))
        yield np.concatenate([along, beside, [end, 0 * end, end + 1e-9]]), 0 * end, end


@pytest.mark.parametrize("name", [*NAMES, "wendland"])
@pytest.mark.parametrize(("dimension", "seen"), SEEN)
def test_segment_integrals_equal_quadrature(name, dimension, seen):
    """Finite everywhere, and equal to quadrature: on the line, at the ends, for branches of no length."""
    kernel = kernel_of(name, 0.7, {}, dimension)
    for points, start, end in segments(seen):
        closed = kernel.segment(points, start, end)
        assert np.isfinite(closed).all()
        largest = kernel.value(0.0, seen).item()
        length = np.linalg.norm(end)
        brute = BruteKernel(name, 0.7, dimension, seen) if name in NAMES else None
        if length <= 1e-3:  # the kernel hardly changes along it
            truth = _gauss(brute or (lambda r: kernel.value(r, seen)), points, end)
        elif brute:
            truth = np.array([brute.segment(p, start, end) for p in points])
        else:
            truth = _gauss(lambda r: kernel.value(r, seen), points, end)
        if name == "heaviside":  # jumps, or rises like a root, at its rim
            rim = np.abs(np.linalg.norm(points, axis=1) - kernel.cutoff) > (
                0.0 if length > 1e-3 else 0.02
            )
            points = points[rim]
            closed = closed[rim]
            truth = truth[rim]
        # what is left: a difference of two antiderivatives over the length, of more terms for the polynomials of
        # a Gaussian; the series of a registered kernel
        rounding = 2e-14 if "gaussian" in name else 1e-14
        tolerance = 1e-10 if name == "wendland" else max(1e-12, rounding / max(length, 1e-4))
        np.testing.assert_allclose(closed, truth, rtol=0, atol=tolerance * largest)


@pytest.mark.parametrize("ratio", [1.5, 3.0, 6.0])
@pytest.mark.parametrize("length", [0.2, 0.69, 0.9, 2.5])
def test_segments_of_the_marginal_of_a_gaussian_of_any_cutoff(ratio, length):
    """Closed forms hold for any width and length (in cutoffs)."""
    kernel = xcg.Gaussian(1.0, cutoff=ratio, dimension=3, shifted=True)
    rng = np.random.default_rng(3)
    end = length * ratio * np.array([0.6, 0.8])
    points = rng.uniform(-1.0, 1.0, (200, 2)) * ratio + rng.uniform(0.0, 1.0, (200, 1)) * end
    truth = np.array([_over_angle(kernel, p, end) for p in points])
    np.testing.assert_allclose(
        kernel.segment(points, 0 * end, end), truth, rtol=0, atol=5e-12 * truth.max()
    )


_MANY_POINTS = np.polynomial.legendre.leggauss(300)


def _over_angle(kernel, point, end):
    """Mean of a kernel along a segment from 0, by many points over the angle along the chord."""
    x, w = _MANY_POINTS
    whole = np.linalg.norm(end)
    foot = point @ end / whole
    across2 = point @ point - foot**2
    half = np.sqrt(max(0.0, kernel.cutoff**2 - across2))
    begin, finish = np.arcsin(
        np.clip(np.array([-foot, whole - foot]) / max(half, 1e-30), -1.0, 1.0)
    )
    angle = 0.5 * (begin + finish) + 0.5 * (finish - begin) * x
    r = np.sqrt(across2 + (half * np.sin(angle)) ** 2)
    return (
        0.5
        * (finish - begin)
        * half
        * (w * np.cos(angle) * kernel.value(r, len(end))).sum()
        / whole
    )


OWN = {
    "wendland": (wendland, ()),
    "cubic spline": (cubic_spline, (1 / 2,)),
    "quintic spline": (quintic_spline, (1 / 3, 2 / 3)),
    "narrow gaussian": (narrow_gaussian, ()),
    "short": (short, (3 / 4,)),
}


def random_segments(seed, seen, count):
    """Points (n, seen) about a segment from 0 to an end, in cutoffs, on its line as well; segments short and long."""
    rng = np.random.default_rng(seed)
    for length in (0.01, 0.1, 0.35, 0.7, 3.0):
        direction = rng.normal(size=seen)
        end = length * direction / np.linalg.norm(direction)
        beside = rng.uniform(-1.0, 1.0, (count, seen)) * rng.choice(
            [0.0, 1e-3, 0.5, 1.0], (count, 1)
        )
        yield beside + rng.uniform(-0.5, 1.5, (count, 1)) * end, end


def line_through(profile, radii, point, end):
    """Mean of a profile along a segment from 0 by scipy, panel by panel: between its kinks, and about the foot."""
    length = np.linalg.norm(end)
    foot = point @ end / length
    inside = []
    across2 = max(0.0, point @ point - foot**2)
    for radius in (*radii, 1.0):
        half = np.sqrt(max(0.0, radius**2 - across2))
        inside += [foot - half, foot + half]
    cuts = np.clip(
        [0.0, foot, *inside, length], max(0.0, inside[-2]), max(0.0, min(length, inside[-1]))
    )

    def value(t):
        return float(profile(np.asarray(min(np.sqrt(across2 + (t - foot) ** 2), 1 - 1e-16))))

    panels = [
        quad(value, a, b, epsabs=1e-15, epsrel=1e-13, limit=200)[0]
        for a, b in pairwise(sorted(cuts))
        if b > a
    ]
    return sum(panels) / length


@pytest.mark.parametrize("name", OWN)
def test_segments_of_registered_kernels_are_integrals_of_their_profiles(name):
    """To 1e-12 of the largest value, and to rounding over the length of short ones."""
    (profile, radii), kernel = OWN[name], kernel_of(name, 1.0, {}, 3)
    unit = kernel.value(0.0, 3).item() / float(profile(np.asarray(0.0)))
    for points, end in random_segments(3, 3, 30):
        found = kernel.segment(points * kernel.cutoff, 0 * end, end * kernel.cutoff) / unit
        truth = np.array([line_through(profile, radii, p, end) for p in points])
        largest = line_through(profile, radii, end / 2, end)
        tolerance = 2e-12 * max(1.0, 0.1 / np.linalg.norm(end))
        np.testing.assert_allclose(found, truth, rtol=0, atol=tolerance * largest)


@pytest.mark.parametrize("name", OWN)
@pytest.mark.parametrize("seen", [1, 2])
def test_segments_of_marginals_equal_those_of_the_kernel_integrated(name, seen):
    """Over one axis that is left out: of the kernel of one dimension more, seen in all of them."""
    radii = OWN[name][1]
    kernel = kernel_of(name, 1.0, {}, seen + 1)
    x, w = np.polynomial.legendre.leggauss(40)
    for points, end in random_segments(seen, seen, 12):
        found = kernel.segment(points * kernel.cutoff, 0 * end, end * kernel.cutoff)
        truth = np.zeros(len(points))
        for k, point in enumerate(points):
            # the least distances from the segment at which its line meets a kink
            foot = np.clip(point @ end / (end @ end), 0.0, 1.0)
            near2 = ((point - foot * end) ** 2).sum()
            far2 = [((point - u * end) ** 2).sum() for u in (0.0, 1.0)]
            line2 = max(0.0, point @ point - (point @ end) ** 2 / (end @ end))
            levels = [
                np.sqrt(max(0.0, r**2 - d)) for r in (*radii, 1.0) for d in (near2, *far2, line2)
            ]
            cuts = np.unique(
                [0.0, *levels, *(max(levels) * np.array([1e-4, 1e-3, 1e-2, 0.1, 0.3]))]
            )
            for a, b in pairwise(cuts):
                # roots at the ends of a panel
                angle = 0.5 * np.pi * x
                z = (0.5 * (a + b) + 0.5 * (b - a) * np.sin(angle)) * kernel.cutoff
                weight = 0.5 * (b - a) * 0.5 * np.pi * w * np.cos(angle) * kernel.cutoff
                places = np.column_stack([np.tile(point * kernel.cutoff, (len(z), 1)), z])
                along = np.append(end, 0.0) * kernel.cutoff
                truth[k] += 2.0 * weight @ kernel.segment(places, 0 * along, along)
        tolerance = 2e-12 * max(1.0, 0.1 / np.linalg.norm(end))
        np.testing.assert_allclose(found, truth, rtol=0, atol=tolerance * np.abs(truth).max())


@pytest.mark.parametrize("name", OWN)
@pytest.mark.parametrize("seen", [1, 2, 3])
def test_stress_of_registered_kernels_balances_forces(name, seen):
    """``(a . grad) S = Psi(end) - Psi(start)`` up to sign, whatever is seen of it: the divergence of contact stress."""
    kernel = kernel_of(name, 1.0, {}, 3)
    h = 2e-3
    reach = np.arange(1, 5) * h
    slope = np.array([4 / 5, -1 / 5, 4 / 105, -1 / 280]) / h
    rng = np.random.default_rng(seen)
    end = 0.4 * kernel.cutoff * np.eye(seen)[0]
    points = rng.uniform(-0.6, 0.6, (60, seen)) * kernel.cutoff + end / 2
    steps = reach[:, None, None] * end
    found = sum(
        c * (kernel.segment(points + s, 0 * end, end) - kernel.segment(points - s, 0 * end, end))
        for c, s in zip(slope, steps, strict=True)
    )
    expected = kernel.value(np.linalg.norm(points, axis=1), seen) - kernel.value(
        np.linalg.norm(points - end, axis=1), seen
    )
    # errors of 1e-12 of its polynomials, over the steps
    tolerance = 2e-9 if name == "narrow gaussian" else 1e-10
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * kernel.value(0.0, seen))


BUILT_IN = {
    "lucy": (xcg.Lucy, lambda q: 1 - 6 * q**2 + 8 * q**3 - 3 * q**4),
    "gaussian": (xcg.Gaussian, lambda q: np.exp(-4.5 * q**2)),
    "shifted": (
        lambda **given: xcg.Gaussian(**given, shifted=True),
        lambda q: np.expm1(4.5 * (1 - q**2)),
    ),
    "heaviside": (xcg.Heaviside, lambda q: 1.0 + 0.0 * q),
}


@pytest.mark.parametrize("name", BUILT_IN)
@pytest.mark.parametrize(("dimension", "seen"), SEEN)
def test_kernels_registered_by_their_profiles_equal_those_of_their_own_loops(name, dimension, seen):
    """Up to the cutoff, where some jump, so that their marginals end like the root of the distance to it."""
    make, profile = BUILT_IN[name]
    own = make(cutoff=1.0, dimension=dimension)
    same = xcg.register_kernel("same", profile, smoothness=own.smoothness)(
        cutoff=1.0, dimension=dimension
    )
    r = np.concatenate([np.linspace(0.0, 0.99, 40), 1 - np.geomspace(1e-9, 1e-2, 15)])
    peak = own.value(0.0, seen)
    # odd powers of q have logarithms at r = 0 in their marginals
    tolerance = 1e-10 if name == "lucy" else 1e-12
    np.testing.assert_allclose(
        same.value(r, seen), own.value(r, seen), rtol=0, atol=tolerance * peak
    )
    if name != "heaviside":  # whose marginal's slope is that of the jump, which is left out
        slope = own.derivative(r, seen)
        tolerance = 1e-6 if name == "lucy" else 1e-9
        np.testing.assert_allclose(
            same.derivative(r, seen), slope, rtol=0, atol=tolerance * np.abs(slope).max()
        )
    for points, end in random_segments(seen, seen, 20):
        tolerance = 1e-11 * max(1.0, 0.1 / np.linalg.norm(end))
        found, expected = (kernel.segment(points, 0 * end, end) for kernel in (same, own))
        np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * peak)


def test_profiles_may_be_objects_that_change():
    """Each registration is of the profile as it then is, and one need not have a hash."""
    parabola = np.poly1d([-1.0, 0.0, 1.0])
    first = xcg.register_kernel("changing", parabola)(cutoff=1.0)
    assert first.value(0.5) == pytest.approx(0.75 * 15 / (8 * np.pi))
    parabola[2] = 0.0
    second = xcg.register_kernel("changing", parabola, smoothness=-1)(cutoff=1.0)
    assert second.value(0.5) == pytest.approx(3 / (4 * np.pi))


def test_kernels_of_few_polynomials_have_closed_forms():
    """Those that are polynomials between any radii, or nearly so; one that jumps; one that takes single numbers."""
    for name in OWN:
        for seen in (1, 2, 3):
            w = kernel_of(name, 1.0, {}, 3).weights(seen)
            assert compiled(has_shells)(w.table)
    w = kernel_of("bump", 1.0, {}, 3).weights(3)
    assert not compiled(has_shells)(w.table)

    def one_by_one(q):
        return math.exp(-2 * q) if q < 0.37 else math.exp(-2 * q) - 0.1

    with pytest.warns(xcg.SceneWarning, match="worst at q=0.3[67]"):
        kernel = xcg.register_kernel("one by one", one_by_one, smoothness=-1)(cutoff=1.0)
    w = kernel.weights(3)
    point = np.array([0.1, 0.2, 0.3])
    end = np.array([0.6, 0.0, 0.1])
    assert compiled(has_shells)(w.table)
    found = kernel.segment([point], 0 * end, end)[0] / w.norm
    assert found == pytest.approx(line_through(one_by_one, (0.37,), point, end), rel=1e-10)


def test_shells_without_the_compiler_have_the_same_bits():
    columns = kernel_of("quintic spline", 0.5, {}, 3).weights(3).table[SHELLS]
    rng = np.random.default_rng(0)
    found = []
    along = rng.uniform(-0.8, 1.4, 64)
    q2 = rng.uniform(0.0, 3.0, 64)
    for fill in (compiled(polynomials.fill_shells), uncompiled(polynomials.fill_shells)):
        out = np.empty(64)
        fill(columns, 0.6, along, np.maximum(q2, along**2), 60, out, closed_for(64))
        found.append(out)
    np.testing.assert_array_equal(*found)
    for h2, t0, t1 in rng.uniform(0.0, 1.0, (20, 3)):
        args = (columns, h2, min(t0, t1) - 0.4, max(t0, t1))
        for line in (polynomials.along_shells, polynomials.along_marginal):
            by_python = uncompiled(line)(*args)
            assert compiled(line)(*args) == pytest.approx(
                by_python, abs=1e-14
            )  # logarithms of two libraries


def test_total_stress_of_a_registered_kernel_is_the_virial():
    """The mean of the contact stress over a periodic box is the sum of forces times branches over its volume."""
    ds = xcg.datasets.random_scene(20, seed=3)
    for kernel in ("cubic spline", "wendland"):
        options = {"kernel": kernel, "width": 1.2, "spacing": 5 / 24}
        found = ds.cg.coarse_grain("contact_stress", **options)
        whole = ds.cg.coarse_grain("contact_stress", axes="", width=1.2)
        mean = found.contact_stress.mean(["x", "y", "z"])
        np.testing.assert_allclose(
            mean, whole.contact_stress, rtol=0, atol=5e-6 * float(abs(mean).max())
        )


def test_profiles_that_are_not_smooth_warn():
    """With the error that their values have, and where."""
    with pytest.warns(
        xcg.SceneWarning, match=r"kernel 'step'.*of its largest value, worst at q=0\.[45]"
    ):
        xcg.register_kernel("step", lambda q: np.where(q < 0.496, 1.0, 0.2), smoothness=-1)
    with pytest.warns(
        xcg.SceneWarning, match=r"kernel 'step': its profile jumps at q=0\.5, and where one axis"
    ):
        xcg.register_kernel("step", lambda q: np.where(q < 0.5, 1.0, 0.2), smoothness=-1)
    with pytest.warns(
        xcg.SceneWarning, match=r"profile to \d\.\de-08 of its largest value"
    ):  # and nothing else
        xcg.register_kernel("single", lambda q: ((1 - q**2) ** 2).astype("float32"))


def test_quadratures_along_contacts_state_their_error():
    """Of a table of 17 numbers, which has more kinks than shells are made of."""
    places = np.linspace(0.0, 1.0, 17)

    def table(q):
        return np.interp(q, places, (1 - places) ** 2)

    with pytest.warns(xcg.SceneWarning) as told:
        kernel = xcg.register_kernel("table", table)(cutoff=1.0)
    off = float(
        re.search(r"quadratures, which are off by (\S+) of the largest", str(told[0].message))[1]
    )
    end = np.array([1.6, 0.0, 0.0])
    points = np.column_stack([np.full(12, 0.8), np.linspace(0.0, 0.59, 12), np.zeros(12)])
    error = np.abs(
        kernel.segment(points, 0 * end, end) / kernel.weights(3).norm
        - _gauss(table, points, end, 2000)
    )
    assert 0.1 * off < 1.6 * error.max() < 3.0 * off


@pytest.mark.parametrize(
    ("profile", "place"),
    [(lambda q: np.exp(-4.5 * q**2), "1"), (lambda q: np.where(q < 0.75, 1 - q, 0.0), r"0\.75")],
)
def test_kernels_that_jump_are_recognised(profile, place):
    """Rules of few points would break the promise of rtol, and kernel gradients leave jumps out."""
    with pytest.warns(xcg.SceneWarning) as told:
        kernel = xcg.register_kernel("jumps", profile)(1.0, dimension=3)
    assert re.search(f"smoothness=2, but its profile jumps at q={place};", str(told[-1].message))
    assert not kernel.differentiable
    assert not gauss_limits(kernel, 2, 1e-3).size


def _gauss(value, points, end, panels=200):
    x, w = np.polynomial.legendre.leggauss(8)
    u = ((np.arange(panels)[:, None] + 0.5 + 0.5 * x) / panels).reshape(-1, 1)
    weights = np.tile(w, panels) / (2 * panels)
    return np.array([value(np.linalg.norm(p - u * end, axis=1)) @ weights for p in points])


@settings(deadline=None, max_examples=40)
@given(
    length=st.floats(1e-3, 4.0),
    rtol=st.sampled_from([1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6]),
    seen=st.integers(1, 3),
    name=st.sampled_from(["lucy", "shifted gaussian", "wendland"]),
    seed=st.integers(0, 1000),
)
def test_errors_are_below_rtol(length, rtol, seen, name, seed):
    """|S_quadrature - S| <= rtol max S for the rule that the planner takes at this branch length."""
    kernel = kernel_of(name, 0.5, {}, 3)  # cutoff 1
    limits = gauss_limits(kernel, seen, rtol)
    orders = [points for points, limit in zip(RULES, limits, strict=False) if length <= limit]
    order = orders[0] if orders else 0
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (2000, seen))
    points[:, 0] = rng.uniform(-1, 1 + length, 2000)
    points[:1000, 1:] *= (
        rng.uniform(0, 1, 1000)[:, None] ** 4
    )  # crowd the line, where the error is largest
    end = length * np.eye(seen)[0]
    exact = kernel.segment(points, 0 * end, end)
    quick = kernel.segment(points, 0 * end, end, order)
    largest = kernel.segment([0.5 * end], 0 * end, end)[0]
    assert np.abs(quick - exact).max() <= rtol * largest
    # closed forms are quicker than any rule, but for Lucy's kernel itself and tables in planes
    ruled = {"lucy": 3}.get(name, 2)
    assert order or length > 0.02 or seen != ruled


def test_fewer_points_for_shorter_branches_and_looser_promises():
    kernel = kernel_of("lucy", 0.5, {}, 3)
    tight = gauss_limits(kernel, 3, 1e-4)
    loose = gauss_limits(kernel, 3, 1e-2)
    assert (np.diff(loose) > 0).all()
    assert (loose > tight).all()
    assert gauss_limits(kernel, 3, 0).size == 0
    assert gauss_limits(kernel_of("gaussian", 0.5, {}, 3), 3, 1e-2).size == 0
    # single precision takes up to twelve points, double precision no more than four
    assert tight.size == loose.size == 6
    assert gauss_limits(kernel, 3, 1e-5).size == 2
    # marginals take their time a point
    assert gauss_limits(kernel, 2, 1e-3).size == gauss_limits(kernel, 1, 1e-3).size == 0
    # registered kernels take their closed form in less than two points, but not in planes; some have none
    assert gauss_limits(kernel_of("wendland", 0.5, {}, 3), 3, 1e-5).size == 0
    assert gauss_limits(kernel_of("wendland", 0.5, {}, 3), 1, 1e-5).size == 0
    assert gauss_limits(kernel_of("wendland", 0.5, {}, 3), 2, 1e-5).size == 6
    assert gauss_limits(kernel_of("quintic spline", 0.5, {}, 3), 3, 1e-5).size == 1
    assert gauss_limits(kernel_of("bump", 0.5, {}, 3), 3, 1e-5).size == 6
    # two points at branch / c = 1/3 leave 1.6e-3 in typical scenes; nowhere twice as much
    assert gauss_limits(kernel, 3, 3.0 * 1.6e-3)[0] > 1 / 3
    assert gauss_limits(kernel, 3, 1.6e-3)[0] < 1 / 3
    # the error of 2, 4, ... points at a branch of c / 3, measured at random places, is where the limits part
    points = np.random.default_rng(4).uniform(-1.0, 1.4, (20_000, 3))
    end = np.array([1 / 3, 0.0, 0.0])
    exact = kernel.segment(points, 0 * end, end)
    for k, order in enumerate((2, 4)):
        error = (
            np.abs(_rule(kernel, points, end, order) - exact).max()
            / kernel.segment([end / 2], 0 * end, end)[0]
        )
        assert gauss_limits(kernel, 3, 3.0 * error)[k] > 1 / 3
        assert gauss_limits(kernel, 3, error)[k] < 1 / 3


def _rule(kernel, points, end, order):
    rule = zip(*np.polynomial.legendre.leggauss(order), strict=True)
    return sum(
        0.5 * w * kernel.value(np.linalg.norm(points - (0.5 + 0.5 * x) * end, axis=1))
        for x, w in rule
    )


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5, 7, 12, 13, 40])
def test_any_number_of_gauss_points(order):
    kernel = kernel_of("lucy", 0.5, {}, 3)
    end = np.array([0.7, -0.2, 0.4])
    points = np.random.default_rng(order).uniform(-0.8, 1.0, (200, 3))
    found = kernel.segment(points, 0 * end, end, order)
    np.testing.assert_allclose(
        found, _rule(kernel, points, end, order), rtol=0, atol=1e-14 * kernel.value(0.0)
    )


@pytest.mark.parametrize("order", [-1, 2.5])
def test_wrong_numbers_of_gauss_points_raise(order):
    with pytest.raises(ValueError, match=f"order={order}: expected a whole number of at least 0"):
        kernel_of("lucy", 0.5, {}, 3).segment(
            [[0.0, 0.0, 0.0]], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], order
        )


def touching(rng, axes):
    """Two spheres of a mean diameter of 1, of any ratio up to 8; their branch as seen, and the largest of f a."""
    ratio = rng.uniform(1.0, 8.0)
    radii = np.array([1.0, ratio]) / (1.0 + ratio)
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    branch = 0.99 * radii.sum() * normal
    place = rng.uniform(-5.0, 5.0, 3)
    force = rng.normal(size=3)
    ds = xcg.scene_from_arrays(
        [place, place - branch], diameter=2 * radii, density=1.0, contact_i=[0], contact_j=[1], contact_force=[force],
        contact_normal=[normal], box=[[-50.0, 50.0]] * 3,
    )  # fmt: skip
    seen = np.array([branch[k] for k, a in enumerate("xyz") if a in axes])
    return ds, seen, np.abs(np.outer(force, branch)).max()


@pytest.mark.parametrize("axes", ["xyz", "xz", "z"])
@pytest.mark.parametrize("kernel", ["lucy", "wendland"])
@pytest.mark.parametrize("width", [0.3, 0.45, 0.75, 1.0, 2.0, 6.0])
def test_the_error_of_every_contact_is_below_rtol(axes, kernel, width):
    """One contact between spheres of any sizes, at random places on the mesh, at widths of 0.3 d to 6 d."""
    rng = np.random.default_rng(round(100 * width))
    shape = kernel_of(kernel, width, {}, 3)
    options = {"axes": axes, "kernel": kernel, "width": width, "spacing": width / 3}
    for _ in range(3):
        ds, branch, force = touching(rng, axes)
        largest = (
            shape.segment([branch / 2], 0 * branch, branch)[0] * force / 100.0 ** (3 - len(axes))
        )
        exact = ds.cg.coarse_grain("contact_stress", **options).contact_stress
        assert 0.3 * largest < float(abs(exact).max()) <= largest * (1 + 1e-12)
        for rtol in (1e-1, 1e-2, 1e-3, 1e-4, 1e-5):
            found = ds.cg.coarse_grain("contact_stress", rtol=rtol, **options).contact_stress
            assert float(abs(found - exact).max()) <= rtol * largest


def test_coarse_graining_with_a_registered_kernel():
    ds = xcg.datasets.random_scene(60, seed=1)
    f = ds.cg.coarse_grain(
        ["density", "contact_stress", "velocity_gradient"],
        kernel="wendland",
        width=0.8,
        gradient="kernel",
    )
    whole = ds.cg.coarse_grain(["density", "contact_stress"], axes="", width=0.8)
    assert float(f.density.mean()) == pytest.approx(float(whole.density.item()), rel=1e-2)
    assert np.isfinite(f.contact_stress).all()


@pytest.mark.parametrize("kernel", [*NAMES, "wendland"])
def test_nodes_on_the_rim_of_a_marginal(kernel):
    """A grain as far away as the support reaches, where its squared distance is rounded to above that."""
    x, z = 10.7, 23.6
    assert ((x - 9.5) / 2.0) ** 2 + ((z - 22.0) / 2.0) ** 2 > 1.0
    ds = xcg.scene_from_arrays(
        [[x, 2.0, z]], diameter=[1.0], density=1.0, box=[[0, 20], [0, 4], [0, 34]], periodic="y"
    )
    width = xcg.Lucy(1.0).cutoff / kernel_of(kernel, 1.0, {}, 3).cutoff
    mesh = {"axes": "xz", "bounds": {"x": (0, 18), "z": (6, 24)}, "spacing": 0.5}
    f = ds.cg.coarse_grain("volume_fraction", kernel=kernel, width=width, **mesh)
    assert np.isfinite(f.volume_fraction).all()
    assert abs(f.volume_fraction.sel(x=9.5, z=22.0).item()) < 1e-2 * float(f.volume_fraction.max())


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: xcg.Lucy(), "width= or cutoff="),
        (lambda: xcg.Lucy(-1.0), "positive length"),
        (lambda: xcg.Lucy(1.0, cutoff=3.0), "contradict"),
        (lambda: xcg.Lucy(1.0, dimension=4), "expected a whole number from 1 to 3"),
        (lambda: xcg.Lucy(1.0, dimension=1).weights(3), "cannot be seen in 3"),
        (lambda: kernel_of(xcg.Lucy(1.0), 2.0, {}, 3), "has its own width"),
        (lambda: xcg.register_kernel("none", lambda q: 0 * q), "positive integral"),
        (lambda: xcg.register_kernel("Lucy", lambda q: 1 - q), "'Lucy'.*a kernel of xcg"),
        (lambda: xcg.register_kernel("shifted gaussian", lambda q: 1 - q), "a kernel of xcg"),
        (lambda: xcg.register_kernel(2, lambda q: 1 - q), "expected a name"),
        (lambda: xcg.register_kernel("a tent", [1.0, 0.0]), "expected a function"),
        (lambda: xcg.register_kernel("a tent", lambda q: 1 - q, ratio=-1.0), "ratio=-1.0"),
        (lambda: xcg.register_kernel("a tent", lambda q: 1 - q, ratio=0), "ratio=0"),
        (lambda: xcg.register_kernel("a tent", lambda q: 1 - q, smoothness=1.5), "smoothness=1.5"),
        (
            lambda: xcg.register_kernel(
                "pole", lambda q: np.where(q > 0, 1 / np.maximum(q, 1e-300), np.inf)
            ),
            "at q=0",
        ),
    ],
)
def test_wrong_kernels_raise(make, message):
    with pytest.raises(ValueError, match=message):
        make()


# --- kernels with negative parts -------------------------------------------------------------------------


def test_fields_of_a_kernel_with_negative_parts_equal_brute_force():
    """What is about a mean is about sum m v Psi / sum m Psi, also where the sum of weights is below zero."""

    def profile(q):
        return (1 - q**2) ** 2 * (1 - 1.5 * q**2)

    xcg.register_kernel("with negative parts", profile)
    rng = np.random.default_rng(1)
    position = rng.uniform(0, 4, (30, 3))
    velocity = rng.normal(size=(30, 3))
    heat = rng.normal(300.0, 1.0, 30)
    ds = xcg.scene_from_arrays(
        position, velocity=velocity, diameter=rng.uniform(0.5, 1, 30), density=1000.0, heat=heat,
        species=rng.integers(1, 3, 30),
    )  # fmt: skip
    fields = [
        "density",
        "velocity",
        "kinetic_stress",
        "heat",
        xcg.Flux("heat"),
        xcg.Variance("heat"),
    ]
    at = {"bounds": dict.fromkeys("xyz", (0.0, 4.0)), "spacing": 1.0}
    f = ds.cg.coarse_grain(
        fields, width=0.7, kernel="with negative parts", by="species", **at
    ).isel(time=0)

    nodes = np.stack(np.meshgrid(f.x, f.y, f.z, indexing="ij"), axis=-1)[..., None, :]
    q = np.minimum(np.linalg.norm(nodes - position, axis=-1) / 1.4, 1)
    radii = (np.arange(10_000) + 0.5) / 10_000
    psi = profile(q) / (4 * np.pi * np.mean(profile(radii) * radii**2) * 1.4**3)
    mass = ds.mass.values[0]
    rho = psi @ mass
    assert (rho < 0).sum() > 5
    with np.errstate(invalid="ignore"):
        v = velocity - ((psi * mass) @ velocity / rho[..., None])[..., None, :]
        dq = heat - (psi @ (mass * heat) / rho)[..., None]
    for phase in ("bulk", "1", "2"):
        weight = psi * mass * (1 if phase == "bulk" else ds.species.values[0] == int(phase))
        own = weight.sum(axis=-1)
        expected = {
            "density": own,
            "kinetic_stress": np.einsum("...g,...gi,...gj->...ij", weight, v, v),
            "flux_heat": np.einsum("...g,...g,...gi->...i", weight, dq, v),
        }
        seen = np.abs(psi).max(axis=-1) > 0
        for name, values in expected.items():
            found = f[name].sel(phase=phase).values
            np.testing.assert_allclose(
                found[seen], values[seen], rtol=0, atol=1e-7 * np.abs(values[seen]).max()
            )
        with np.errstate(invalid="ignore"):
            ratios = {
                "velocity": weight @ velocity / own[..., None],
                "heat": weight @ heat / own,
                "variance_heat": np.maximum((weight * dq**2).sum(axis=-1) / own, 0),
            }
        for name, values in ratios.items():
            found = f[name].sel(phase=phase).values
            np.testing.assert_allclose(
                found, values, rtol=1e-6, atol=1e-6 * np.nanmedian(np.abs(values))
            )
    steps = ds.cg.coarse_grain(
        ["density", "velocity", "heat"], width=0.7, kernel="with negative parts", **at
    )
    mean = xcg.time_average(steps)
    for name in ("density", "velocity", "heat"):
        np.testing.assert_allclose(mean[name], steps[name].isel(time=0), rtol=1e-12)
