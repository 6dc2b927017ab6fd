"""Pictures of the gallery in 3D: those that can be turned come with a page of vtk.js."""

from pathlib import Path

import pytest

from tests import pyvista_draws

pytest.importorskip("trame_vtk")
pytest.importorskip("trame_pyvista")
pytest.importorskip("sphinx_gallery")
pv = pytest.importorskip("pyvista")


@pytest.mark.parametrize("script", ["impact", "segregation"])
def test_listed_scripts_have_pictures_that_can_be_turned(script, tmp_path, monkeypatch):
    if not pyvista_draws():
        pytest.skip("VTK finds no way to draw")
    from docs.figures import ROTATABLE, SCENES, draw_3d

    pv.close_all()  # those of other tests, which would be drawn as well
    monkeypatch.setattr(pv, "BUILDING_GALLERY", True)
    plotter = pv.Plotter(off_screen=True, window_size=(60, 40))
    plotter.add_mesh(pv.Cube(), color="white")
    plotter.show(auto_close=False)
    variables = {
        "src_file": f"examples/gallery/cases/{script}.py",
        "image_path_iterator": iter([str(tmp_path / "picture.png")]),
    }
    text = draw_3d(("code", "", 12), variables, {"src_dir": str(tmp_path)})
    assert (tmp_path / "picture.png").exists()
    pages = [path.name for path in Path(tmp_path, SCENES).glob("*")]
    assert pages == ([f"{script}_12_0.html"] if script in ROTATABLE else [])
    assert ("<iframe" in text) == (script in ROTATABLE)
    assert all(f"../scenes/{page}" in text for page in pages)
