"""Frames of a movie, of which only what moves is drawn anew."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from xcg.common.checks import extra
from xcg.common.drawing import layout

_GREYS = 32  # of the 256 colours of a frame, for letters and lines

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from PIL import Image


class Film:
    """Figure for movies, with one pair of axes on which lines and areas move.

    What stands still, such as axes, labels and the colour bar, is drawn once. Drawing it for each
    frame takes half of the time of a movie.
    """

    def __init__(self, size: tuple[float, float], dpi: float) -> None:
        agg = extra("matplotlib.backends.backend_agg", "plot", "a movie")
        figures = extra("matplotlib.figure", "plot", "a movie")
        self._figure = figures.Figure(figsize=size, dpi=dpi, layout=layout())
        self._canvas = agg.FigureCanvasAgg(self._figure)
        self._background: Any = None
        self.axes: Axes = self._figure.add_subplot()

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the figure, as writers ask for its size."""
        return getattr(self._figure, name)

    def clear(self) -> None:
        """Remove the lines, areas and images of the last frame."""
        for artist in (*self.axes.lines, *self.axes.collections, *self.axes.images):
            artist.remove()
        self.axes.set_prop_cycle(None)

    def draw(self) -> None:
        """Draw the lines, areas and title that the axes have now over what stands still."""
        ax = self.axes
        moving = [a for a in ax.get_children() if a not in (ax.patch, ax.xaxis, ax.yaxis)]
        if self._background is None:
            self._figure.draw_without_rendering()
            self._figure.set_layout_engine(None)  # that of the first frame stays
            for artist in moving:
                artist.set_animated(True)
            self._canvas.draw()
            self._background = self._canvas.copy_from_bbox(self._figure.bbox)
        self._canvas.restore_region(self._background)
        for artist in sorted(moving, key=lambda artist: artist.get_zorder()):
            ax.draw_artist(artist)

    def image(self, cmap: str | None = None) -> Image.Image:
        """Return the frame in the colours of a map and greys, or in 256 of its own.

        Pillow's usual choice of 256 colours takes eight times as long as its octree, which shows
        as bands on a map.
        """
        images = extra("PIL.Image", "plot", "a movie")
        pixels = self._canvas.buffer_rgba()
        rgba = images.frombuffer("RGBA", pixels.shape[1::-1], pixels, "raw", "RGBA", 0, 1)
        image = rgba.convert("RGB")
        if cmap is None:
            return image.quantize(method=images.Quantize.FASTOCTREE)
        colours = extra("matplotlib", "plot", "a movie").colormaps.get_cmap(cmap)
        greys = np.repeat(np.linspace(0, 1, _GREYS)[:, None], 3, axis=1)
        rows = np.concatenate([colours(np.linspace(0, 1, 256 - _GREYS))[:, :3], greys])
        palette = images.new("P", (1, 1))
        palette.putpalette(np.rint(255 * rows).astype("uint8").tobytes())
        return image.quantize(palette=palette, dither=images.Dither.NONE)

    def savefig(self, sink: Any, **_: Any) -> None:
        """Write the pixels of the frame, four bytes each, in place of drawing them again."""
        sink.write(self._canvas.buffer_rgba())
