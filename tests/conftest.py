from __future__ import annotations

import gc
import os
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from datetime import UTC, datetime
from itertools import product
from multiprocessing import get_context
from unittest import mock

import pytest

# idle threads of OpenMP and BLAS spin, which slows down other workers of pytest
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import dask

from xcg.readers.engines.lammps import Lammps
from xcg.readers.engines.mfix import Mfix


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Leave modules and tests, which all stay, out of each later search for garbage."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.fixture(autouse=True, scope="session")
def _own_cache(tmp_path_factory):
    """Keep the index of files that tests read out of the user's cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        # processes that tests start share the bytecode of our modules: a third of a second each
        patch.setenv("PYTHONDONTWRITEBYTECODE", "")
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


@pytest.fixture(scope="session")
def cluster():
    """Cluster of two processes, without a client; it takes seconds to start, so tests share it."""
    distributed = pytest.importorskip("distributed")
    # its own watches would take a tenth of a core for as long as the session lasts
    settings = {
        "distributed.admin.system-monitor.gil.enabled": False,
        "distributed.admin.system-monitor.interval": "10s",
        "distributed.admin.tick.interval": "1s",
        "distributed.worker.memory.monitor-interval": "5s",
        "distributed.worker.memory.terminate": False,
        "distributed.worker.profile.enabled": False,
    }
    with (
        dask.config.set(settings),
        distributed.LocalCluster(
            n_workers=2,
            threads_per_worker=2,
            processes=True,
            dashboard_address=":0",
            memory_limit=None,
        ) as running,
    ):
        yield running


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
