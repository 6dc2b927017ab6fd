"""Every answer of the page "How do I ..." runs."""

import ast
import re
import shutil

import matplotlib as mpl
import pandas as pd
import pytest

from tests import ROOT, pyvista_draws, real_data

mpl.use("agg")
plt = pytest.importorskip("matplotlib.pyplot")
PAGE = (ROOT / "docs" / "how_do_i.md").read_text()
SETTING, *ANSWERS = re.split(r"^### ", PAGE, flags=re.MULTILINE)
BLOCK = re.compile(r"```python\n(.*?)```", re.DOTALL)
OPTIONAL = {
    "explore": "panel",
    "contact_graph(": "networkx",
    "pyvista(": "pyvista",
    "view(": "pyvista",
}  # packages that answers need besides matplotlib
LIGGGHTS = """ITEM: TIMESTEP
10
ITEM: NUMBER OF {what}
{n}
ITEM: BOX BOUNDS pp pp ff
0 1
0 1
0 1
ITEM: {what} {names}
{rows}
"""


@pytest.fixture(autouse=True)
def _close():
    """Leave no figure that the next answer would draw into."""
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def setting():
    """What the page says first."""
    names: dict = {}
    exec(BLOCK.search(SETTING)[1], names)
    frames = [0, 0, 1, 1]
    particles = [0, 1, 0, 1]
    tracks = {
        "frame": frames,
        "particle": particles,
        "x": [1.0, 3.0, 1.1, 3.2],
        "y": 1.0,
        "mass": 800.0,
    }
    return names | {"tracks": pd.DataFrame(tracks)}


@pytest.fixture
def files(tmp_path, monkeypatch):
    """Files of the four codes, under the names of the page."""
    chute = ROOT / "examples" / "data" / "lammps_chute"
    data = ROOT / "tests" / "data"
    places = {
        **{p.name: p for p in chute.glob("*.gz")},
        "P_0004.vtp": real_data("mfix_chute") / "P_FB1_0004.vtp",
        "FC_0004.vtp": real_data("mfix_chute") / "FC_0004.vtp",
        **{
            f"run.{kind}": data / "mercury_synthetic" / f"syn200.{kind}"
            for kind in ("data", "fstat", "restart")
        },
    }
    for name, path in places.items():
        shutil.copy(path, tmp_path / name)
    post = tmp_path / "post"
    post.mkdir()
    grains = ["1 1 0.5 0.5 0.5 0 0 0 0.05", "2 1 0.5 0.5 0.59 0 0 0 0.05"]
    (post / "dump10.txt").write_text(
        LIGGGHTS.format(
            what="ATOMS", n=2, names="id type x y z vx vy vz radius", rows="\n".join(grains)
        )
    )
    pair = "0.5 0.5 0.5 0.5 0.5 0.59 1 2 0 0 0 -5"
    names = " ".join(f"c_c[{k}]" for k in range(1, 13))
    (post / "pairs10.txt").write_text(LIGGGHTS.format(what="ENTRIES", n=1, names=names, rows=pair))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    "answer",
    [
        # test_plots draws movies
        pytest.param(text, marks=pytest.mark.slow if text.startswith("... make a movie?") else ())
        for text in ANSWERS
    ],
    ids=lambda text: text.partition("\n")[0].removeprefix("... "),
)
@pytest.mark.filterwarnings("ignore")  # of steps of other boxes, of files without units
def test_each_answer_runs(answer, setting, files, monkeypatch):
    (code,) = BLOCK.findall(answer)
    for method, package in OPTIONAL.items():
        if method in code:
            module = pytest.importorskip(package)
            if package == "pyvista":
                if not pyvista_draws():
                    pytest.skip("VTK finds no way to draw")
                monkeypatch.setattr(module, "OFF_SCREEN", True)
    assert len(ast.parse(code).body) <= 3
    names = dict(setting)
    exec(code, names)
    for name in set(names) - set(setting) | {"ds", "f"}:
        if hasattr(names[name], "compute") and names[name] is not setting.get(name):
            names[name].compute()


def test_first_lines_of_the_readme_run():
    (code,) = re.findall(
        r"```python\n(.*?)```",
        (ROOT / "README.md").read_text().partition("## Try it")[0],
        re.DOTALL,
    )
    exec(code, {})
