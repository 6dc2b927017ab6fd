from __future__ import annotations

from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from datetime import UTC, datetime
from fnmatch import fnmatch
from itertools import product
from multiprocessing import get_context
from unittest import mock

import pytest

from tests import ROOT
from xcg.readers.engines.lammps import Lammps
from xcg.readers.engines.mfix import Mfix

# Marked slow: tests that take seconds and repeat the ground of others, which are named.
SLOW = {
    "architecture/test_error_context.py::*-view-*": "the other methods, and test_view",
    "compiled/test_uncompiled.py::*": "test_references, with the loops in NumPy",
    "compiled/test_jit.py::test_a_change_of_another_file*False*": "the same with a folder that can be written",
    "compiled/test_jit.py::test_damaged_code*nbi*": "the damaged machine code",
    "docs/test_accuracy.py::test_errors_of_kernel_tables*": "the other panels",
    "docs/test_accuracy.py::test_every_panel_has_a_default*[[][cptv]*": "the other panels",
    "docs/test_cfd_dem.py::test_the_example*": "test_cells and test_without_kernel",
    "docs/test_how_do_i.py::*make a movie*": "test_plots draws movies",
    "docs/test_gallery.py::test_each_script_agrees*[[][bcdfilms]*": "building the site; scripts of other letters",
    "fields/analysis/test_widths.py::test_the_chosen_width*[[]s[h]*": "the sine",
    "fields/analysis/test_widths.py::test_the_chosen_width*[[][bcl]*": "the other flows",
    "fields/analysis/test_diffusion.py::test_errors_equal*": "test_widths and test_averages on errors of means",
    "fields/grids/test_points.py::test_loops_over_points_run_uncompiled*": "fields at points equal those of a mesh",
    "fields/test_cells.py::test_cells_hold_all_mass*0.7*": "the other meshes",
    "fields/test_cells.py::test_totals_are_kept*": "totals on given meshes",
    "fields/test_cells.py::*shifted gaussian*": "the other kernels",
    "fields/test_cells.py::test_polynomials_that_meet*-0.6*": "the same with larger cells",
    "fields/test_cells.py::test_polynomials_that_meet*[[][js][tu]*": "splines, kinks and cores",
    "identities/*any_scene*": "the same identities on given scenes, and any_scene in test_coarse_grain",
    "jobs/test_run.py::test_a_full_disk*600000*": "the disk that is full at once",
    "packing/test_network.py::test_random_packings_percolate*": "percolation equals that of copies of the box",
    "readers/test_engine.py::test_xarray_opens*": "test_backend, and the same package through open_scene",
    "steps/test_memory.py::test_memory_does_not_grow*.[zv]*": "the same with the other formats",
    "writers/test_record.py::test_a_killed_recorder*nc*": "the recorder of Zarr, and kills of NetCDF stores",
    "writers/test_save.py::test_a_killed_writer*between*": "the kills before and after",
    "writers/test_store.py::test_a_killed_process*-write-*": "the kills at other places",
    "writers/test_store.py::test_a_killed_process*-log-*": "the kills at other places",
}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests of `SLOW`."""
    for item in items:
        place = f"{item.path.relative_to(ROOT / 'tests').as_posix()}::{item.name}"
        if any(fnmatch(place, pattern) for pattern in SLOW):
            item.add_marker("slow")


@pytest.fixture(autouse=True, scope="session")
def _own_cache(tmp_path_factory):
    """Keep the index of files that tests read out of the user's cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(autouse=True, scope="session")
def _one_time():
    """Stop the clock of histories, so that results of one second and of the next are identical."""
    with mock.patch(
        "xcg.steps.labels.datetime", **{"now.return_value": datetime(2026, 1, 1, tzinfo=UTC)}
    ):
        yield


@pytest.fixture(autouse=True)
def _own_fields():
    """Forget the fields that a test registers."""
    with mock.patch.dict("xcg.fields.formulas.registry.REGISTERED"):
        yield


@pytest.fixture(scope="session")
def computing():
    """Arguments of `compute` for one of dask's schedulers; a process takes seconds to start, so tests share it."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        processes = {"scheduler": "processes", "pool": pool}
        yield (
            lambda name: processes if name == "processes" else {"scheduler": name, "num_workers": 2}
        )


@pytest.fixture
def reads(monkeypatch):
    """Count the bodies that the engines of LAMMPS and MFiX read, by kind and step."""
    counts: Counter = Counter()
    for engine, kind in product((Lammps, Mfix), ("particles", "contacts")):
        original = getattr(engine, f"read_{kind}")

        def counted(self, ref, options, kind=kind, original=original):
            counts[kind, ref.step] += 1
            return original(self, ref, options)

        monkeypatch.setattr(engine, f"read_{kind}", counted)
    return counts
