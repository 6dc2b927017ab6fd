"""Linear fits: explicit pseudo-inverses, and eigenvectors where grains are almost flat."""

import numpy as np
import pytest

from xcg.compiled import gradient_fit

SLOPE = np.array([[0.3, -1.2, 0.5], [0.8, 0.1, -0.4], [-0.6, 0.9, 0.2]])


def moments_of(x, u, mass):
    """Sums over grains of some nodes, from places and velocities (nodes, grains, 3), as `fit_gradient` takes them."""
    momentum, offset = (np.einsum("ng,ngi->in", mass, a) for a in (u, x))
    shear, spread = (np.einsum("ng,ngi,ngj->ijn", mass, a, x) for a in (u, x))
    count = np.full((1, len(x)), float(x.shape[1]))
    parts = [
        count,
        mass.sum(axis=1)[None],
        momentum,
        offset,
        shear.reshape(9, -1),
        spread[np.triu_indices(3)],
    ]
    return np.concatenate(parts)


def parts_of(found):
    """Gradient, explained part (3, 3, nodes), determined axes, centre of mass (3, nodes), inverse (3, 3, nodes)."""
    gradient, explained, determined, mean, inverse = np.split(
        found,
        (gradient_fit.EXPLAINED, gradient_fit.DETERMINED, gradient_fit.MEAN, gradient_fit.INVERSE),
    )
    return (
        gradient.reshape(3, 3, -1),
        explained[gradient_fit.SYMMETRIC],
        determined,
        mean,
        inverse[gradient_fit.SYMMETRIC],
    )


def grains(seed, flat=()):
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1, 1, (40, 12, 3))
    mass = rng.uniform(0.1, 1, (40, 12))
    x[..., list(flat)] = 0.0
    return x, mass


def by_eigenvectors(sums, active, about_node):
    """As `fit_gradient`, all nodes by NumPy's eigenvectors."""
    count = sums[gradient_fit.COUNT]
    mass = sums[gradient_fit.MASS]
    momentum = sums[gradient_fit.MOMENTUM : gradient_fit.OFFSET]
    offset = sums[5:8]
    shear = sums[gradient_fit.SHEAR : gradient_fit.SPREAD].reshape(3, 3, -1)
    spread = sums[gradient_fit.SPREAD :][gradient_fit.SYMMETRIC]
    there = mass > 0.0
    drift, mean = (
        np.divide(a, mass, out=np.zeros_like(a), where=there) for a in (momentum, offset)
    )
    if about_node:
        mean[:] = 0.0
    values, vectors = np.linalg.eigh(np.moveaxis(spread - mean[:, None] * offset, -1, 0))
    rounding = 1e-13 * np.trace(spread)
    least = np.where(
        values.sum(axis=1) > rounding, np.maximum(1e-9 * values[:, 2], rounding), np.inf
    )
    spanned = values > least[:, None]
    scaled = vectors * np.divide(1.0, values, out=np.zeros_like(values), where=spanned)[:, None]
    projection = (vectors**2 * spanned[:, None]).sum(axis=2).T
    determined = there & (~np.reshape(active, (3, 1)) | (projection > 1.0 - 1e-6))
    moved = np.moveaxis(shear - drift[:, None] * offset, -1, 0)
    inverse = scaled @ vectors.swapaxes(1, 2)
    gradient = moved @ inverse
    six = np.triu_indices(3)
    explained = (gradient @ moved.swapaxes(1, 2))[:, *six]
    inverse = inverse[:, *six]
    explained[count <= spanned.sum(axis=1) + 1] = np.nan
    determined = np.where(determined, 1.0, np.nan)
    return np.concatenate([gradient.reshape(-1, 9).T, explained.T, determined, mean, inverse.T])


@pytest.mark.parametrize("about_node", [False, True])
@pytest.mark.parametrize("flat", [(), (1,), (0, 2)])
@pytest.mark.parametrize("count", [1, 2, 3, 4, 12])
def test_fits_are_those_by_eigenvectors(count, flat, about_node):
    """Grains in a point, on a line, in a plane; the axes along which all are at zero are active or not."""
    x, mass = grains(3, flat)
    x = x[:, :count]
    mass = mass[:, :count]
    u = np.random.default_rng(4).normal(size=x.shape)
    sums = moments_of(x, u, mass)
    for active in (tuple(k not in flat for k in range(3)), (True,) * 3):
        compare(sums, active, about_node)


def compare(sums, active, about_node):
    quick = parts_of(gradient_fit.fit_gradient(sums, active=active, about_node=about_node))
    slow = parts_of(by_eigenvectors(sums, active, about_node))
    seen = (
        np.abs(slow[0]).max(axis=(0, 1)) < 1e3
    )  # nodes whose grains are not almost on a line or in a plane
    assert seen.mean() > 0.9
    for one, other in zip(quick, slow, strict=True):
        axes = tuple(range(other.ndim - 1))
        size = np.maximum(
            1.0, np.abs(np.nan_to_num(other)).max(axis=axes)
        )  # eigenvectors round by that of the node
        np.testing.assert_allclose(
            (one / size)[..., seen], (other / size)[..., seen], rtol=0, atol=1e-8
        )


@pytest.mark.parametrize("thickness", [1e-2, 1e-3, 1e-4, 1e-6])
@pytest.mark.parametrize("line", [False, True])
def test_grains_that_are_nearly_flat_are_fitted_in_full(line, thickness):
    """Grains close to a tilted plane or line: the gradient across is theirs to what rounding leaves, or none is."""
    rng = np.random.default_rng(9)
    turned = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    x, mass = grains(10)
    x = x * [1.0, thickness if line else 0.9, thickness] @ turned.T
    found = gradient_fit.fit_gradient(
        moments_of(x, x @ SLOPE.T, mass), active=(True,) * 3, about_node=False
    )
    gradient, _, determined, *_ = parts_of(found)
    if thickness > 1e-5:
        np.testing.assert_allclose(
            gradient, np.broadcast_to(SLOPE[..., None], gradient.shape), atol=1e-14 / thickness**2
        )
        assert (determined == 1.0).all()
    else:  # thinner than what counts as flat
        spanned = turned[:, :1] @ turned[:, :1].T if line else turned[:, :2] @ turned[:, :2].T
        expected = np.broadcast_to((SLOPE @ spanned)[..., None], gradient.shape)
        np.testing.assert_allclose(gradient, expected, atol=1e-5)
        assert np.isnan(determined).all()


def test_a_linear_field_is_fitted_without_residual():
    x, mass = grains(5)
    u = x @ SLOPE.T + np.array([2.0, -1.0, 0.5])
    sums = moments_of(x, u, mass)
    gradient, explained, determined, *_ = parts_of(
        gradient_fit.fit_gradient(sums, active=(True,) * 3, about_node=False)
    )
    np.testing.assert_allclose(
        gradient, np.broadcast_to(SLOPE[..., None], gradient.shape), atol=1e-12
    )
    about = u - (np.einsum("ng,ngi->ni", mass, u) / mass.sum(axis=1)[:, None])[:, None]
    np.testing.assert_allclose(
        explained, np.einsum("ng,ngi,ngj->ijn", mass, about, about), atol=1e-11
    )
    assert (determined == 1.0).all()


def test_grains_in_a_plane_give_no_gradient_across_it():
    x, mass = grains(6, flat=(2,))
    sums = moments_of(x, x @ SLOPE.T, mass)
    gradient, explained, determined, *_ = parts_of(
        gradient_fit.fit_gradient(sums, active=(True,) * 3, about_node=False)
    )
    assert (determined[:2] == 1.0).all()
    assert np.isnan(determined[2]).all()
    np.testing.assert_allclose(
        gradient[:, :2], np.broadcast_to(SLOPE[:, :2, None], (3, 2, 40)), atol=1e-12
    )
    assert (gradient[:, 2] == 0).all()
    assert np.isfinite(explained).all()


def test_fits_to_no_grain_one_grain_or_damaged_sums_are_nan():
    x, mass = grains(7)
    u = x @ SLOPE.T
    one = np.where(np.arange(40) == 0, 0.0, moments_of(x[:, :1], u[:, :1], mass[:, :1]))
    one[gradient_fit.SPREAD :, 1] = np.inf
    gradient, explained, determined, mean, _ = parts_of(
        gradient_fit.fit_gradient(one, active=(True,) * 3, about_node=False)
    )
    assert np.isnan(determined).all()
    assert (gradient[..., [0, *range(2, 40)]] == 0).all()
    assert np.isnan(explained).all()
    assert (mean[:, 0] == 0).all()
