"""Draw the picture of the start page: python docs/front.py, which writes docs/_static/front.png."""

import io
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pyvista
from PIL import Image

import xcg

mpl.use("agg")
from matplotlib import pyplot as plt

PICTURE = Path(__file__).parent / "_static" / "front.png"
CAMERA = [(28, -48, 27), (10.5, 4.5, 10.6), (0, 0, 1)]  # from where, to where, what is up
FASTEST = 10.0


def draw_scene(*, as_field: bool) -> np.ndarray:
    """Draw a chute flow as grains, or the velocity field that they make."""
    ds = xcg.datasets.open("chute").compute()
    plotter = pyvista.Plotter(off_screen=True, window_size=(1400, 1200))
    if as_field:
        f = ds.cg.coarse_grain("velocity", width=1.0, spacing=0.4)
        field = f.sel(z=slice(-0.5, None)).cg.to_pyvista()
        field = field.threshold(scalars="velocity", all_scalars=True)
        plotter.add_mesh(field, scalars="velocity", clim=(0, FASTEST), lighting=False)
    else:
        grains = ds.drop_dims("contact").drop_vars("box").assign_attrs(periodic="")
        grains.cg.view("velocity", vmin=0, vmax=FASTEST, plotter=plotter)
    for title in list(plotter.scalar_bars.keys()):
        plotter.remove_scalar_bar(title)
    plotter.camera_position = CAMERA
    plotter.hide_axes()
    return plotter.screenshot(return_img=True)


def cropped(picture: np.ndarray) -> np.ndarray:
    """Return a picture without its white margins."""
    drawn = (picture < 255).any(axis=-1)
    rows = np.flatnonzero(drawn.any(axis=1))
    columns = np.flatnonzero(drawn.any(axis=0))
    return picture[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def main() -> None:
    """Draw grains, field and a bar of their colours side by side: a picture as wide as the page."""
    figure, axes = plt.subplots(1, 2, figsize=(13, 4.8), layout="constrained")
    for ax, as_field in zip(axes, (False, True), strict=True):
        ax.imshow(cropped(draw_scene(as_field=as_field)), interpolation="antialiased")
        ax.axis("off")
    speeds = mpl.cm.ScalarMappable(mpl.colors.Normalize(0, FASTEST), "viridis")
    bar = figure.colorbar(speeds, ax=axes, shrink=0.8, aspect=18, pad=0.03)
    bar.set_label(r"speed [$\sqrt{g\,d}$]", fontsize=17)
    bar.ax.tick_params(labelsize=15)
    file = io.BytesIO()
    figure.savefig(file, dpi=110)
    Image.open(file).convert("RGB").quantize(256).save(PICTURE, optimize=True)


if __name__ == "__main__":
    main()
