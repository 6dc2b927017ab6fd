"""Draw the picture of the front page: python docs/front.py, which writes docs/_static/front.png."""

from pathlib import Path

import pyvista

import xcg

PICTURE = Path(__file__).parent / "_static" / "front.png"
CAMERA = [(28, -48, 27), (10.5, 4.5, 10.6), (0, 0, 1)]  # from where, to where, what is up


def main() -> None:
    """Draw the left half of a chute flow as grains, and the right half as the velocity field that they make."""
    ds = xcg.datasets.open("chute").compute()
    f = ds.cg.coarse_grain("velocity", width=1.0, spacing=0.4)
    plotter = pyvista.Plotter(off_screen=True, window_size=(1000, 640))
    grains = ds.isel(particle=(ds.position.sel(component="x")[0] < 9.6).values).drop_dims("contact")
    grains.drop_vars("box").assign_attrs(periodic="").cg.view(
        "velocity", vmin=0, vmax=10, plotter=plotter
    )
    field = (
        f.sel(x=slice(9.6, None), z=slice(-0.5, None))
        .cg.to_pyvista()
        .threshold(scalars="velocity", all_scalars=True)
    )
    plotter.add_mesh(field, scalars="velocity", clim=(0, 10), show_scalar_bar=False, lighting=False)
    plotter.camera_position = CAMERA
    plotter.hide_axes()
    plotter.screenshot(PICTURE)


if __name__ == "__main__":
    main()
