"""Draw the picture of the front page: python docs/front.py, which writes docs/_static/front.png."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
import pyvista

import xcg

mpl.use("agg")
from matplotlib import pyplot as plt

PICTURE = Path(__file__).parent / "_static" / "front.png"
CAMERA = [(28, -48, 27), (10.5, 4.5, 10.6), (0, 0, 1)]  # from where, to where, what is up
MIDDLE = 9.6  # x between grains and field
FASTEST = 10.0


def draw_scene() -> np.ndarray:
    """Draw the left half of a chute flow as grains, and the right half as the velocity field that they make."""
    ds = xcg.datasets.open("chute").compute()
    f = ds.cg.coarse_grain("velocity", width=1.0, spacing=0.4)
    plotter = pyvista.Plotter(off_screen=True, window_size=(1400, 1200))
    is_left = ds.position.sel(component="x")[0] < MIDDLE
    grains = ds.isel(particle=is_left.values).drop_dims("contact")
    colours = {"vmin": 0, "vmax": FASTEST, "plotter": plotter}
    grains.drop_vars("box").assign_attrs(periodic="").cg.view("velocity", **colours)
    field = f.sel(x=slice(MIDDLE, None), z=slice(-0.5, None)).cg.to_pyvista()
    field = field.threshold(scalars="velocity", all_scalars=True)
    plotter.add_mesh(field, scalars="velocity", clim=(0, FASTEST), lighting=False)
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
    """Draw the scene and a bar of its colours, with equal margins on all sides."""
    figure, ax = plt.subplots(figsize=(8, 6.4))
    ax.imshow(cropped(draw_scene()), interpolation="antialiased")
    ax.axis("off")
    speeds = mpl.cm.ScalarMappable(mpl.colors.Normalize(0, FASTEST), "viridis")
    bar = figure.colorbar(speeds, ax=ax, shrink=0.6, aspect=14, pad=0.12)
    bar.set_label(r"speed [$\sqrt{g\,d}$]", fontsize=22)
    bar.ax.tick_params(labelsize=20)
    figure.savefig(PICTURE, dpi=120, bbox_inches="tight", pad_inches=0.3)


if __name__ == "__main__":
    main()
