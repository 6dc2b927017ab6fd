"""Frames that are drawn over what stands still have the pixels of whole pictures."""

import io

import numpy as np
import pytest

from xcg.analysis.film import Film

pytest.importorskip("matplotlib")


def pixels(film):
    sink = io.BytesIO()
    film.savefig(sink)
    return np.frombuffer(sink.getvalue(), np.uint8).reshape(100, 150, 4).copy()


def drawn_whole(film):
    for artist in film.axes.get_children():
        artist.set_animated(False)
    film.canvas.draw()
    return np.asarray(film.canvas.buffer_rgba()).copy()


@pytest.mark.parametrize("kind", ["lines", "mesh", "image"])
def test_each_frame_is_as_if_it_were_drawn_whole(kind):
    rng = np.random.default_rng(0)
    film = Film((1.5, 1.0), dpi=100)
    frames = []
    for k in range(3):
        film.clear()
        if kind == "lines":
            film.axes.plot(rng.random(5), label="one")
            film.axes.set_ylim(0, 1)
            film.axes.legend()
        else:
            draw = {"mesh": film.axes.pcolormesh, "image": film.axes.imshow}[kind]
            mesh = draw(rng.random((4, 5)), vmin=0, vmax=1)
            if k == 0:
                film.colorbar(mesh, ax=film.axes)
        film.axes.set_title(f"step {k}")
        film.draw()
        frames.append(pixels(film))
    assert not np.array_equal(frames[0], frames[2])
    np.testing.assert_array_equal(frames[2], drawn_whole(film))
    assert len([*film.axes.lines, *film.axes.collections, *film.axes.images]) == 1


@pytest.mark.parametrize("cmap", ["viridis", "RdBu_r", None])
def test_images_have_the_colours_of_the_frame(cmap):
    """Half a step of 224 colours is 2 of 255 or less, and Pillow rounds by 4; an octree has steps of 16."""
    film = Film((1.5, 1.0), dpi=100)
    if cmap:
        mesh = film.axes.imshow(np.linspace(0, 1, 400).reshape(20, 20), cmap=cmap)
        film.colorbar(mesh, ax=film.axes)
    else:
        film.axes.plot(np.random.default_rng(0).random((5, 3)))
    film.draw()
    expected = pixels(film)[..., :3].astype(int)
    image = np.asarray(film.image(cmap).convert("RGB")).astype(int)
    away = np.abs(image - expected).max(axis=2)
    most = 16
    inside = np.ones(away.shape, bool)
    if cmap:
        most = 6
        edges = film.axes.get_window_extent().padded(-3).extents.astype(int)
        inside = np.zeros(away.shape, bool)
        inside[100 - edges[3] : 100 - edges[1], edges[0] : edges[2]] = True
    assert inside.sum() > 1000
    assert away[inside].max() <= most
    assert away[(expected == 255).all(axis=2)].max() <= (0 if cmap else 4)
    assert len(np.unique(image.reshape(-1, 3), axis=0)) <= 256
