"""Pictures of the gallery: small enough for their letters to be read on a phone, and some that can be turned."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib import pyplot as plt
from pyvista.plotting.plotter import _ALL_PLOTTERS
from pyvista.plotting.utilities.sphinx_gallery import Scraper
from trame_vtk.tools.vtksz2html import write_html

ROTATABLE = ("impact", "silo_pressure")  # scripts whose picture in 3D can be turned with the mouse
SCENES = "gallery/scenes"  # folder of these pictures, in the sources and in the site
_FRAME = """
.. raw:: html

    <details><summary>Turn this picture with the mouse ({size:.0f} MB)</summary>
    <iframe src="../scenes/{name}" loading="lazy" title="picture in 3D"
     style="width: 100%; height: 30rem; border: 0"></iframe></details>
"""

STYLE = {
    "figure.figsize": (5.2, 3.9),
    "figure.constrained_layout.use": True,
    "font.size": 12,
    "legend.fontsize": 11,
    "image.cmap": "viridis",
}


def legible(configuration: dict[str, Any], script: str) -> None:
    """Set the style before each script of the gallery, whatever the one before it set."""
    mpl.use("agg")
    plt.rcdefaults()
    plt.rcParams.update(STYLE)


def draw_3d(block: Any, variables: dict[str, Any], configuration: dict[str, Any]) -> str:
    """Save the pictures of PyVista, for sphinx-gallery; some of them again in a page of vtk.js."""
    scenes = [plotter.last_vtksz for plotter in _ALL_PLOTTERS.values()]
    text = Scraper()(block, variables, configuration)
    script = Path(variables["src_file"]).stem
    if script not in ROTATABLE:
        return text
    folder = Path(configuration["src_dir"], SCENES)
    folder.mkdir(parents=True, exist_ok=True)
    for k, scene in enumerate(scenes):
        name = f"{script}_{block[2]}_{k}.html"
        with open(folder / name, "w", encoding="utf-8") as page:
            write_html(scene, page)
        text += _FRAME.format(name=name, size=(folder / name).stat().st_size / 1e6)
    return text
