"""Compiled code on disk: used again, made anew where it is stale or damaged, never needed; threads within a step."""

import gc
import io
import os
import shutil
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import numba
import pytest

from tests import ROOT
from tests.loops import compiled
from xcg.compiled import _jit
from xcg.compiled._jit import for_each, leaf
from xcg.compiled.matrices import dot

COMPILED = ROOT / "xcg" / "compiled"
INNER = """from xcg.compiled._jit import jit
@jit
def inner(x):
    return x + 1
"""
OUTER = """from xcg.compiled._jit import jit
from xcg.compiled.inner import inner
@jit
def outer(x):
    return 2 * inner(x)
"""


def write_package(folder):
    """Write a package of that name with two small loops, one of which is compiled into the other."""
    compiled = folder / "xcg" / "compiled"
    compiled.mkdir(parents=True)
    (folder / "xcg" / "__init__.py").touch()
    for name in ("__init__", "_jit"):
        shutil.copy(COMPILED / f"{name}.py", compiled)
    (compiled / "inner.py").write_text(INNER)
    (compiled / "outer.py").write_text(OUTER)


@pytest.fixture
def package(tmp_path):
    write_package(tmp_path)
    return tmp_path


def call(package, argument="1.0", **env):
    """Result of the outer loop in a new process, and how often it was found compiled."""
    code = (
        f"import sys; from xcg.compiled.outer import outer; print(outer({argument}), "
        "sum(outer.stats.cache_hits.values()), 'numba.np.linalg' in sys.modules)"
    )
    given = {
        "PYTHONPATH": str(package),
        "HOME": str(package / "home"),
        "XDG_CACHE_HOME": str(package / "home" / "cache"),
        # Python takes bytecode of a source that is changed within a second for that of the new one
        "PYTHONDONTWRITEBYTECODE": "1",
        **env,
    }
    kept = {
        name: value for name, value in os.environ.items() if not name.startswith(("NUMBA_", "XCG_"))
    }
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env=kept | given,
        cwd=package,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    value, hits, has_compiler = done.stdout.split()
    assert has_compiler == str(hits == "0")  # what Numba compiles with takes a process 0.17 s
    return float(value), int(hits)


@pytest.fixture(scope="module")
def run_once(tmp_path_factory):
    folder = tmp_path_factory.mktemp("used")
    write_package(folder)
    assert call(folder) == (4, 0)
    return folder


@pytest.fixture
def used(run_once, tmp_path):
    """The package, with compiled code beside it."""
    return shutil.copytree(run_once, tmp_path / "used")


# a folder that cannot be written to takes another way to the same code
@pytest.mark.parametrize("beside", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_change_of_another_file_is_noticed(package, beside):
    place = package / "xcg" / "compiled" / "__pycache__"
    if beside:
        place.mkdir()
        (place / "kernels.digest").write_bytes(b"\xff\xfe")  # damaged, of earlier versions
    else:
        place.write_text("")
    assert call(package) == (4, 0)
    (package / "xcg" / "compiled" / "inner.py").write_text(INNER.replace("+ 1", "+ 2"))
    assert call(package) == (6, 0)
    assert call(package) == (6, 1)


def zeros_within(data):
    start = data.index(b"\x7fELF") + 64  # in the machine code, behind the header
    return data[:start] + bytes(32) + data[start + 32 :]


# a damaged index is noticed as damaged machine code is
@pytest.mark.parametrize(
    ("kind", "damage"),
    [
        pytest.param("nbi", lambda _: b"\xff", marks=pytest.mark.slow),
        ("nbc", zeros_within),
    ],
)
def test_damaged_code_is_made_anew(used, kind, damage):
    (path,) = used.rglob(f"outer*.{kind}")
    path.write_bytes(damage(path.read_bytes()))
    assert call(used) == (4, 0)
    assert call(used) == (4, 1)


def test_code_for_other_arguments_is_made_anew(used):
    # two processes that save at the same time may take one name for the code of both
    (of_floats,) = used.rglob("outer*.nbc")
    assert call(used, "1") == (4, 0)
    (of_integers,) = set(used.rglob("outer*.nbc")) - {of_floats}
    shutil.copy(of_floats, of_integers)
    assert call(used, "1") == (4, 0)
    assert call(used, "1") == (4, 1)


def test_code_runs_where_no_cache_folder_can_be_written(package):
    for place in (package / "home", package / "xcg" / "compiled" / "__pycache__"):
        place.write_text(
            "a file where the folder should be: not even the superuser can write to it"
        )
    assert call(package) == (4, 0)


def test_code_runs_where_the_cache_index_cannot_be_replaced(used):
    (index,) = used.rglob("outer*.nbi")
    index.unlink()
    (index / "a").mkdir(parents=True)
    assert call(used) == (4, 0)


def test_the_cache_can_be_turned_off(used):
    assert call(used, XCG_JIT_CACHE="0") == (4, 0)


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_leaf_functions_cannot_be_called_from_python():
    along = 1.0, 2.0, 3.0
    assert compiled(dot)(along, along) == 14.0
    with pytest.raises(
        TypeError, match=r"dot is compiled for loops; from Python, call dot\.py_func"
    ):
        dot(along, along)
    assert dot.py_func(along, along) == 14.0


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
@pytest.mark.parametrize("on", [True, False])
def test_collection_of_garbage_waits_for_the_compiler_alone(on):
    during = []

    @numba.extending.intrinsic
    def looked(context):
        during.append(gc.isenabled())
        return numba.int64(), lambda context, builder, signature, args: context.get_constant(
            numba.int64, 2
        )

    @leaf
    def fails(x):
        return x.no_such_attribute

    was_on = gc.isenabled()
    try:
        (gc.enable if on else gc.disable)()
        assert numba.njit(lambda: looked())() == 2
        assert not any(during)
        assert gc.isenabled() == on
        with pytest.raises(numba.TypingError):
            fails(1)
        assert gc.isenabled() == on
    finally:
        (gc.enable if was_on else gc.disable)()


@pytest.mark.parametrize("terminal", [True, False])
def test_the_first_compilation_is_announced_in_a_terminal(terminal, monkeypatch):
    stream = io.StringIO()
    monkeypatch.setattr(stream, "isatty", lambda: terminal)
    monkeypatch.setattr(sys, "stderr", stream)
    listener = _jit._Compiling()
    for function in (os.getcwd, _jit.for_each, _jit.for_each):
        started = SimpleNamespace(data={"dispatcher": SimpleNamespace(py_func=function)})
        listener.on_start(started)
        listener.on_end(started)
    said = "xcg compiles its loops for this machine; this takes some seconds, once.\n"
    assert stream.getvalue() == (said if terminal else "")


# --- threads within one step -----------------------------------------------------------------------------


@pytest.mark.parametrize("threads", [1, 2, 3, 8])
def test_results_come_in_the_order_of_the_items(threads):
    def slower_first(k):
        time.sleep(0.01 * (5 - k))
        return k * k

    assert for_each(range(6), slower_first, threads) == [0, 1, 4, 9, 16, 25]


def test_the_calling_thread_takes_part():
    both = threading.Barrier(2, timeout=10)  # is passed by two threads or not at all
    found = for_each(range(2), lambda _: both.wait() >= 0 and threading.get_ident(), 2)
    assert found[0] != found[1] == threading.get_ident()


@pytest.mark.parametrize(("threads", "bad"), [(1, 0), (2, 9)])
def test_an_error_of_the_calling_thread_stops_the_rest(threads, bad):
    done = []

    def fail(k):
        if k == bad:
            msg = f"item {k}"
            raise ValueError(msg)
        time.sleep(0.02)
        done.append(k)

    with pytest.raises(ValueError, match=f"item {bad}"):
        for_each(range(10), fail, threads)
    assert len(done) <= threads  # what the others had begun


def test_an_error_of_another_thread_is_raised():
    both = threading.Barrier(2, timeout=10)

    def fail(k):
        both.wait()
        if k == 0:
            msg = "item 0"
            raise ValueError(msg)

    with pytest.raises(ValueError, match="item 0"):
        for_each(range(2), fail, 2)
