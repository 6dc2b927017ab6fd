"""Pictures keep all of their text inside of the figure, whatever the shape of a map."""

import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr

import xcg  # noqa: F401  (the accessor)

mpl.use("agg")
plt = pytest.importorskip("matplotlib.pyplot")

SHAPES = [(1, 1), (1, 2), (1, 5), (1, 15), (2, 1), (5, 1), (15, 1), (40, 1)]


@pytest.mark.parametrize(
    ("wide", "high", "scale"),
    [(*shape, scale) for shape, scale in zip(SHAPES, [1e-5, 0.1] * 4, strict=True)],
)
def test_maps_of_any_shape_have_all_text_inside_of_the_figure(wide, high, scale):
    """With units of SI: long numbers at the axes, and a label of two lines beside the bar."""
    axes = {"x": np.linspace(0, wide * scale, 20), "z": np.linspace(0, high * scale, 20)}
    numbers = np.random.default_rng(0).random((20, 20))
    fields = {
        "pressure": (1e5 * numbers, "Pa", "pressure"),
        "density": (1e3 * (1 + numbers), "kg m^-3", "mass density of the mixture"),
        "angle": (1e-7 * numbers, "kg m^-1 s^-2", "a long name of a field of contacts of phases"),
    }
    data = {}
    for name, (values, units, text) in fields.items():
        data[name] = (("x", "z"), values, {"units": units, "long_name": text})
    f = xr.Dataset(data, {a: (a, nodes, {"units": "m"}) for a, nodes in axes.items()})
    f = f.assign_coords(time=1.23456e-4, y=0.00123)
    for name in fields:
        figure = f.cg.plot(name).figure
        figure.canvas.draw()
        drawn = figure.get_tightbbox()
        width, height = figure.get_size_inches()
        assert min(drawn.x0, drawn.y0) >= -0.005, name
        assert drawn.x1 <= width + 0.005, name
        assert drawn.y1 <= height + 0.005, name
        plt.close(figure)
