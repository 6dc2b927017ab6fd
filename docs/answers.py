"""Draw the pictures of the page "How do I ...?": python -m docs.answers, which writes docs/_static/answer_*.png."""

import io
import warnings
from pathlib import Path

import numpy as np
import pyvista
import xarray as xr
from matplotlib import pyplot as plt
from PIL import Image

import xcg
from docs.figures import legible

PICTURES = Path(__file__).parent / "_static"


def write(name: str, picture: Image.Image) -> None:
    """Write a picture in 128 colours, which makes it small."""
    picture.convert("RGB").quantize(128, dither=Image.Dither.NONE).save(
        PICTURES / f"answer_{name}.png", optimize=True
    )


def save(name: str) -> None:
    """Write the current figure, and close it."""
    file = io.BytesIO()
    plt.gcf().savefig(file, dpi=100, bbox_inches="tight")
    plt.close()
    write(name, Image.open(file))


def flow() -> None:
    """Draw a plane, and a time average with its error, of the sheared spheres of the page."""
    ds = xcg.datasets.open("plane_shear")
    plane = ds.cg.coarse_grain(["density", "velocity"], axes="xz", at={"y": 2.0})
    plane.cg.plot("velocity")
    save("plane")
    mean = ds.cg.coarse_grain(axes="z").cg.time_average()
    mean.cg.plot("velocity", component="x")
    save("average")


def compare() -> None:
    """Draw the difference of two runs, and a law of discharge, as the page does."""
    ds = xcg.datasets.open("plane_shear")
    fields = ["density", "velocity"]
    a = ds.isel(time=slice(0, 8)).cg.coarse_grain(fields, axes="z").cg.time_average()
    b = ds.isel(time=slice(8, 17)).cg.coarse_grain(fields, like=a).cg.time_average()
    xcg.compare(a, b).cg.plot("velocity", component="x")
    save("compare")
    rates = []
    for opening in (4, 5, 6):
        q = xcg.datasets.open(f"hopper_{opening}").cg.flow_rate(xcg.Plane((9, 0, 6), (0, 0, -1)))
        rates.append(q.cg.time_average().assign_coords(opening=float(opening)))
    constants = {"density": 0.9 * 4, "diameter": 1.0, "gravity": 1.0, "exponent": 1.5}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", xcg.SceneWarning)  # three points for two parameters
        law = xr.concat(rates, "opening").cg.fit_law("beverloo", constants=constants)
    law.cg.plot()
    save("beverloo")


def heap() -> None:
    """Draw the free surface of a heap of discs, and the line that fits it."""
    ds = xcg.datasets.open("column_2").isel(time=[-1])
    f = ds.cg.coarse_grain("volume_fraction", axes="xy", width=1.5, spacing=0.5).compute()
    surface = f.cg.free_surface("y").isel(time=0)
    part = surface.sel(x=slice(20, 90))  # without the wall and the foot
    fit = part.cg.fit_slope()
    _, ax = plt.subplots(figsize=(6.4, 2.0))
    f.isel(time=0).cg.plot("volume_fraction", ax=ax)
    ax.plot(surface.x, surface.height, "r-", lw=1.5, label="free surface")
    line = part.height.mean() + fit.slope.item() * (part.x - part.x.mean())
    ax.plot(
        part.x,
        line,
        "w--",
        lw=2,
        label=f"angle {fit.angle.item():.1f} ± {fit.angle_error.item():.1f}°",
    )
    ax.set(xlim=(0, 130), ylim=(0, 32), title="")
    ax.legend(loc="upper right", facecolor="0.5", labelcolor="w")
    save("heap")


def biaxial() -> None:
    """Draw the force chains of a biaxial test, and the shear strain between two steps of it."""
    ds = xcg.datasets.open("biaxial")
    ds.cg.displacement(["shear_strain"], width="2 d43", spacing=0.5).isel(time=1).cg.plot(
        "shear_strain", vmax=0.3
    )
    save("strain")
    ds.cg.force_chains(alpha=45, min_stress="mean").cg.plot_chains(index=1)
    save("chains")
    p = ds.cg.microstructure("normal_force_pdf").normal_force_pdf.isel(time=-1, drop=True)
    p = p.reset_coords(drop=True)
    p.where(p > 0).plot.line("o-", xscale="log", yscale="log")
    save("forces")
    xcg.datasets.open("plane_shear").cg.plot_rose(plane="xz")
    save("rose")


def view() -> None:
    """Draw a volume of the sheared spheres in 3D."""
    volume = xcg.datasets.open("plane_shear").cg.coarse_grain(["velocity", "density"], spacing=0.3)
    plotter = pyvista.Plotter(off_screen=True, window_size=(620, 420))
    volume.cg.view("velocity", plotter=plotter)
    write("view", Image.fromarray(np.asarray(plotter.screenshot(return_img=True))))
    grains = xcg.datasets.open("plane_shear").isel(time=[-1]).cg.derive("pressure")
    plotter = pyvista.Plotter(off_screen=True, window_size=(620, 420))
    grains.cg.view("pressure", plotter=plotter)
    write("grains", Image.fromarray(np.asarray(plotter.screenshot(return_img=True))))


def main() -> None:
    """Draw all pictures."""
    warnings.simplefilter("ignore")
    legible({}, "")
    for draw in (flow, compare, heap, biaxial, view):
        draw()


if __name__ == "__main__":
    main()
