"""Draw twelve pictures of the gallery on a sheet: python -m docs.gallery_sheet writes docs/_static/gallery.png."""

from __future__ import annotations

import contextlib
import io
import runpy
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pyvista

mpl.use("agg")
from matplotlib import pyplot as plt

GALLERY = Path(__file__).parents[1] / "examples" / "gallery"
PICTURE = Path(__file__).parent / "_static" / "gallery.png"
STYLE = {"figure.figsize": (5.2, 3.9), "figure.constrained_layout.use": True, "font.size": 12}
SCRIPTS = {  # script: title
    "classics/column_collapse": "Collapse of a column",
    "classics/silo_discharge": "Discharge of a silo",
    "classics/mu_of_i": "Rheology mu(I)",
    "classics/shear_band": "Shear band",
    "classics/drum_mixing": "Mixing in a drum",
    "classics/cooling_gas": "Cooling gas",
    "cases/heap": "Slope of a deposit",
    "cases/segregation": "Segregation",
    "cases/bedload": "Bedload",
    "cases/photoelastic": "Photoelastic discs",
    "cases/dense_suspension": "Dense suspension",
    "cases/voronoi_cells": "Voronoi cells",
}


def picture_of(script: str) -> np.ndarray:
    """Run a script of the gallery, and return its first picture."""
    pyvista.OFF_SCREEN = True
    try:
        with plt.rc_context(STYLE), contextlib.redirect_stdout(io.StringIO()):
            runpy.run_path(str(GALLERY / f"{script}.py"))
            figure = plt.figure(plt.get_fignums()[0])
            buffer = io.BytesIO()
            figure.savefig(buffer, dpi=70)  # makes ticks, in the style as well
    finally:
        plt.close("all")
    buffer.seek(0)
    return plt.imread(buffer)


def main() -> None:
    """Draw the sheet."""
    pictures = {title: picture_of(script) for script, title in SCRIPTS.items()}
    figure, axes = plt.subplots(3, 4, figsize=(14, 8.6), layout="constrained")
    for ax, (title, picture) in zip(axes.flat, pictures.items(), strict=True):
        ax.imshow(picture)
        ax.set_title(title)
        ax.axis("off")
    figure.savefig(PICTURE, dpi=90)


if __name__ == "__main__":
    main()
