"""How pictures of the gallery look: small enough for their letters to be read on a phone."""

from typing import Any

import matplotlib as mpl
from matplotlib import pyplot as plt

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
