"""Movies of results: the picture of each step, with the same axes and colours."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path

import xarray as xr

from xcg.analysis.draw_pictures import Frames, title_of
from xcg.analysis.film import Film
from xcg.analysis.picture import (
    Shading,
    Shown,
    without_empty_parts,
)
from xcg.common import drawing
from xcg.common.checks import POSITIVE, check, extra
from xcg.common.messages import unknown
from xcg.scene.frame import require_steps, with_time
from xcg.steps.mapping import each_step, shown

FRAME = (7.0, 5.0)  # inches of a movie


def movie(
    f: xr.Dataset,
    path: str | os.PathLike[str],
    field: str | None = None,
    *,
    component: str | None = None,
    direction: str | None = None,
    phase: int | str | None = None,
    at: Mapping[str, float] | None = None,
    arrows: str | None = "auto",
    shading: Shading = "smooth",
    fps: float = 10.0,
    dpi: float = 120.0,
    progress: bool | None = None,
    cmap: str | None = None,
    vmin: float | None = None,
    vmax: float | None = None,
) -> Path:
    """Write a movie of one field: the picture of `plot` for each step, with the same axes and colours in all of them.

    Parameters
    ----------
    f : xarray.Dataset
        A result with several steps, lazy or in memory. What is drawn of all steps is held in
        memory.
    path : str or path
        ``*.gif``, or ``*.mp4``, which needs the program ffmpeg (``pip install imageio-ffmpeg``). A
        file of this name is replaced.
    field, component, direction, phase, at, arrows, shading, cmap, vmin, vmax
        As in `plot`; all steps share the ends of the colours.
    fps : float
        Steps in a second.
    dpi : float
        Dots in an inch; a frame is up to 7 by 5 inches, or 7 inches high where a map is tall.
    progress : bool, optional
        Show the progress on the standard error; by default in a terminal or notebook where it takes
        long.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    ImportError
        If matplotlib is not installed.
    OSError
        If there is neither ffmpeg nor imageio-ffmpeg, for mp4.
    ValueError
        If the result has no dimension ``time``, the name ends otherwise, or as in `plot`.
    """
    path = Path(path)
    if path.suffix not in (".gif", ".mp4"):
        raise ValueError(f"{path}: expected a name that ends with .gif or .mp4")
    check("fps", fps, POSITIVE)
    check("dpi", dpi, POSITIVE)
    matplotlib = extra("matplotlib", "plot", "a movie")
    maps = matplotlib.colormaps
    if cmap is not None and not (isinstance(cmap, str) and cmap in maps):
        raise ValueError(
            unknown("colour map", cmap, maps, "others are listed by matplotlib.colormaps")
        )
    f = with_time(f)
    if "time" not in f.dims:
        raise ValueError(
            "movie needs a result with the dimension 'time'; draw a single step with plot"
        )
    require_steps(f, "movie")
    program = ""
    if path.suffix == ".mp4":
        program = _ffmpeg(path)
    choice = Shown(field, component, direction, phase, at, arrows, shading)
    part = choice.part(f)
    count = part.sizes["time"]
    steps = []
    with shown(count, progress, what="steps computed") as bar:
        for step in each_step(part):
            steps.append(choice.step(step, 0))
            bar.update()
    ends = {"cmap": cmap, "vmin": vmin, "vmax": vmax}
    frames = Frames.of(without_empty_parts(steps, f), shading, ends, {})
    size = FRAME
    if frames.ratio is not None:
        size = drawing.size_of_figure(FRAME, frames.ratio)
    film = Film(size, dpi)
    part_of_file = path.with_name(f".{path.stem}.part{path.suffix}")

    def drawn() -> Iterator[None]:
        with shown(count, progress, what="frames drawn") as bar:
            for picture in frames.pictures:
                film.clear()
                frames.draw(picture, film.axes)
                drawing.set_title(film.axes, title_of(picture))
                film.draw()
                yield
                bar.update()

    try:
        if path.suffix == ".gif":
            images = [film.image(frames.keywords.get("cmap")) for _ in drawn()]
            later = images[1:]
            images[0].save(
                part_of_file, save_all=True, append_images=later, duration=int(1000 / fps), loop=0
            )
        else:
            animation = extra("matplotlib.animation", "plot", "a movie")
            with matplotlib.rc_context({"animation.ffmpeg_path": program}):
                writer = animation.writers["ffmpeg"](fps=fps)
                with writer.saving(film, part_of_file, dpi):
                    for _ in drawn():
                        writer.grab_frame()
        part_of_file.replace(path)
    finally:
        part_of_file.unlink(missing_ok=True)
    return path


def _ffmpeg(path: Path) -> str:
    """Return the program ffmpeg: the one of the system, or the one that imageio-ffmpeg brings along."""
    program = shutil.which(extra("matplotlib", "plot", "a movie").rcParams["animation.ffmpeg_path"])
    if program is not None:
        return program
    try:
        from imageio_ffmpeg import get_ffmpeg_exe

        return str(get_ffmpeg_exe())
    except (ImportError, RuntimeError):  # RuntimeError: without a program for this machine
        raise OSError(
            f"{path}: mp4 needs the program ffmpeg: pip install imageio-ffmpeg, or apt or conda install "
            "ffmpeg; or write a .gif"
        ) from None
