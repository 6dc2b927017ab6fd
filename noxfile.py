"""Checks of xcg, each in an environment of its own: `nox --list`, then `nox --session full`."""

import re
import shutil
from pathlib import Path
from zipfile import ZipFile

import nox

nox.needs_version = ">=2024.10"
nox.options.default_venv_backend = "venv"
nox.options.sessions = ["lint", "tests"]

ROOT = Path(__file__).parent
PYPROJECT = nox.project.load_toml("pyproject.toml")
# readers, fields, averages, packings, chains and writers; none of them needs an optional package
CORE = [
    "analysis/test_force_chains", "analysis/test_find_contacts", "fields/formulas/test_averages",
    "fields/test_coarse_grain", "readers/engines/test_lammps", "readers/engines/test_mercury", "test_datasets",
    "writers/test_vtkhdf",
]  # fmt: skip
RUNNER = ["pytest>=8.0", "pytest-benchmark>=5.0", "pytest-xdist>=3.6", "hypothesis>=6.100"]
OPTIONAL = [
    "matplotlib",
    "zarr",
    "sklearn",
    "distributed",
    "bokeh",
    "panel",
    "networkx",
    "pyvista",
    "pyarrow",
]
# what docs/works.md and its neighbours show, in about the order of their time
EXAMPLES = [
    "erodible_bed",
    "compression",
    "pile",
    "maps",
    "force_chains",
]  # examples/, with a folder
MODULES = [
    "works", "kernels", "width_study", "lattice", "nine_grains", "quasi_static_figures", "stability",
    "stability_curves", "levels", "gallery_sheet", "needs", "cost", "contact_speed",
]  # fmt: skip
LARGEST_WHEEL = 8_500_000  # bytes, most of them sample data


def group(name):
    """Return the requirements of a dependency group of pyproject.toml."""
    return nox.project.dependency_groups(PYPROJECT, name)


def run_core(session, *options):
    """Run the core tests on the installed package, in a folder that does not hold its sources."""
    folder = Path(session.create_tmp()) / "run"
    shutil.rmtree(folder, ignore_errors=True)
    for name in ["tests", "docs", "examples"]:
        shutil.copytree(
            ROOT / name, folder / name, ignore=shutil.ignore_patterns("_build", "__pycache__")
        )
    for name in ["pyproject.toml", "README.md", "CITATION.cff", "LICENSE"]:
        shutil.copy(ROOT / name, folder)
    session.chdir(folder)
    session.run(
        "python", "-c", "import xcg; print(xcg.__file__); assert 'site-packages' in xcg.__file__"
    )
    files = [f"tests/{name}.py" for name in CORE]
    # warnings are of versions that a developer may never see: they do not fail here
    session.run(
        "python", "-m", "pytest", "-q", "-p", "no:cacheprovider", "-W", "default", "--numprocesses", "auto",
        "--dist", "worksteal", *files, *options, *session.posargs,
    )  # fmt: skip


@nox.session
def lint(session):
    """Check style and types."""
    session.install("--editable", ".", *group("test"), *group("lint"))
    session.run("ruff", "check")
    session.run("ruff", "format", "--check")
    session.run("mypy")


@nox.session
def tests(session):
    """Run the tests, but not those marked slow."""
    session.install("--editable", ".", *group("test"))
    session.run("pytest", "--numprocesses", "auto", "--dist", "worksteal", *session.posargs)


@nox.session
def full(session):
    """Run all tests, also those marked slow: long fuzzing under bounds checks."""
    session.install("--editable", ".", *group("test"))
    session.run(
        "pytest",
        "--numprocesses",
        "auto",
        "--dist",
        "worksteal",
        "-m",
        "slow or not slow",
        *session.posargs,
    )


@nox.session(python="3.11")
def minimum(session):
    """Run the core tests with the lowest versions that pyproject.toml allows, on the oldest Python."""
    project = PYPROJECT["project"]
    extras = [name for names in project["optional-dependencies"].values() for name in names]
    lowest = [
        re.sub(r">=(\d+(?:\.\d+)*)", r"==\1.*", name)
        for name in [*project["dependencies"], *extras]
    ]
    constraints = Path(session.create_tmp()) / "lowest.txt"
    constraints.write_text(
        "\n".join(dict.fromkeys(re.sub(r"\[\w+\]", "", name) for name in lowest))
    )
    session.install(".", *RUNNER, "--constraint", str(constraints))
    session.run("pip", "list")
    # VTK 9.3 to 9.7.1 misreads flat images in VTKHDF (docs/saving.md); so these are not tested with the lowest VTK
    run_core(
        session,
        "-k",
        "not (test_reads_back_equal or test_axes_with_one_node or test_fixed_axes_give_the_origin)",
    )


@nox.session
def newest(session):
    """Run the core tests with the newest versions, also those before a release."""
    session.install("--upgrade", "--upgrade-strategy", "eager", "--pre", ".", *RUNNER)
    session.run("pip", "list")
    run_core(session)


@nox.session
def bare(session):
    """Run the core tests without any optional package."""
    session.install(".", *RUNNER)
    session.run("pip", "uninstall", "--yes", "matplotlib")  # vtk brings it along, and does without
    absent = f"from importlib.util import find_spec; assert not [name for name in {OPTIONAL} if find_spec(name)]"
    session.run("python", "-c", absent)
    run_core(session)


@nox.session
def explore(session):
    """Run the tests of the explorer in Chromium, which has to be installed."""
    session.install("--editable", ".", *group("explore"), *RUNNER)
    session.run("pytest", "tests/explore", *session.posargs)


@nox.session
def wheel(session):
    """Build and check wheel and source package; run the core tests on the installed wheel."""
    dist = Path(session.create_tmp()) / "dist"
    shutil.rmtree(dist, ignore_errors=True)
    session.install("build", "twine")
    session.run("python", "-m", "build", "--outdir", str(dist), ".")
    (built,), (source,) = dist.glob("*.whl"), dist.glob("*.tar.gz")
    session.run("twine", "check", "--strict", str(built), str(source))
    session.run(
        "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(dist / "again"), str(source)
    )
    (again,) = (dist / "again").glob("*.whl")
    names = set(ZipFile(built).namelist())
    if differing := names ^ set(ZipFile(again).namelist()):
        session.error(f"only one of wheel and source package holds {sorted(differing)}")
    if built.stat().st_size > LARGEST_WHEEL:
        session.error(
            f"{built.name} has {built.stat().st_size} bytes, more than {LARGEST_WHEEL}: leave out samples"
        )
    session.log(f"{built.name}: {built.stat().st_size} bytes, {len(names)} files")
    session.install(str(built), *RUNNER)
    session.run("pip", "check")
    session.run("xcg", "fields", silent=True)
    run_core(session)


@nox.session
def docs(session):
    """Build the documentation, with warnings as errors: `nox -s docs -- folder`, docs/_build by default."""
    session.install("--editable", ".", *group("docs"))
    folder = session.posargs or ["docs/_build"]
    session.run("python", "-m", "sphinx", "-W", "--keep-going", "--fresh-env", "docs", *folder)


@nox.session
def works(session):
    """Make the pictures and tables of the three works again, on a machine that does nothing else."""
    session.install("--editable", ".", *group("docs"), *group("test"), *group("benchmark"))
    pictures = ROOT / "docs" / "_static"
    for name in EXAMPLES:
        folder = Path(session.create_tmp()) / name
        session.run("python", f"examples/{name}.py", str(folder))
        for picture in folder.glob("*.png"):
            shutil.copy(picture, pictures)
    for name in MODULES:
        session.run("python", "-m", f"docs.{name}")


@nox.session
def speed(session):
    """Compare the speed of the working tree with that of main, on a machine that does nothing else."""
    session.install("--editable", ".", *group("test"))
    session.run("python", "-m", "docs.speed", "--against", "main", *session.posargs)


@nox.session
def lammps(session):
    """Run LAMMPS itself, and compare scenes and fields of its files with the numbers that it prints."""
    session.install("--editable", ".", *group("test"), *group("quasi-static"))
    # the wheels put the MPI library that LAMMPS asks for here
    libraries = str(Path(session.virtualenv.location) / "lib")
    files = ["tests/codes", "tests/readers/test_live.py"]
    session.run("pytest", "-r", "s", *files, *session.posargs, env={"LD_LIBRARY_PATH": libraries})
