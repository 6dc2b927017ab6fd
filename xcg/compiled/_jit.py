"""Every decision about compilation, in one place.

Loops release the GIL, so that dask's threads run them side by side; they are serial, because a
parallel loop under a threaded scheduler aborts the interpreter. Arithmetic is strict: the compiler
may neither reorder nor contract it, so that results have the same bits in every process and at
every number of threads.

Compiled code is kept on disk, so that a second process starts at once: in ``NUMBA_CACHE_DIR`` where
that is set, else beside the sources, else in the user's cache, and nowhere if none of them can be
written. ``XCG_JIT_CACHE=0`` turns that off, for example where machines of different kinds share an
installation.
"""

from __future__ import annotations

import gc
import hashlib
import os
import pickle
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numba

# Numba's private names are used in this module alone, which hands on `cgutils` (to write LLVM
# instructions) to others. Tried with Numba 0.61 and 0.68. There is no public cache with a
# checksum, no public event of compilation, and no public switch for counts of references.
from numba.core import cgutils as cgutils
from numba.core import event
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.runtime import rtsys
from numba.core.serialize import dumps
from numba.core.sigutils import normalize_signature

# Threads for a single step in memory (NUMBA_NUM_THREADS, else the processors of this process).
THREADS = numba.config.NUMBA_NUM_THREADS
CACHE = os.environ.get("XCG_JIT_CACHE", "1") != "0"


def _digest_of_sources() -> str:
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()


_SOURCES = _digest_of_sources()


def is_interactive() -> bool:
    """Return whether the standard error is that of a terminal or notebook."""
    return sys.stderr.isatty() or type(sys.stderr).__module__.startswith("ipykernel")


class _Checked(CompileResultCacheImpl):
    """Compiled code with a checksum: the processor would run whatever a damaged file holds."""

    def reduce(self, result: Any) -> tuple[bytes, bytes]:
        data = dumps(super().reduce(result))
        return hashlib.sha256(data).digest(), data

    def rebuild(self, target_context: Any, payload: tuple[bytes, bytes]) -> Any:
        digest, data = payload
        if hashlib.sha256(data).digest() != digest:
            raise ValueError("the compiled code is damaged")
        return super().rebuild(target_context, pickle.loads(data))


class _Cache(FunctionCache):
    """Numba's cache of a function, for which damaged code and that of other sources count as none.

    Numba looks at the file of the function alone, but code from other files is compiled into it.
    """

    _impl_class = _Checked

    def __init__(self, function: Callable) -> None:
        super().__init__(function)
        self._cache_file._source_stamp = self._cache_file._source_stamp, _SOURCES

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        # `super().load_overload` would first load all that Numba needs to compile, which takes as
        # long as reading 100 MB; compiled code needs memory alone
        rtsys.initialize(target_context)
        try:
            result = self._load_overload(sig, target_context)
        except Exception:  # a damaged file can make unpickling raise anything
            result = None
            try:
                self.flush()
            except OSError:
                self.disable()
        # two processes that save at once may take one file for the code of different arguments
        types, _ = normalize_signature(sig)
        if result is not None and tuple(result.signature.args) != tuple(types):
            return None
        return result

    def save_overload(self, sig: Any, data: Any) -> None:
        with suppress(OSError):  # a full disk, a folder that is gone
            super().save_overload(sig, data)


_NOTICE = "xcg compiles its loops for this machine; this takes some seconds, once.\n"


class _Compiling(event.Listener):
    """Pause Python's garbage collector while Numba compiles: it would scan all objects many times.

    In a terminal or notebook, the first loop of the package that is compiled is announced.
    """

    def __init__(self) -> None:
        self._depth = 0  # compilations under way: one may start others
        self._was_on = False
        self._announced = False

    def on_start(self, started: event.Event) -> None:
        # None for code from a text
        ours = str(started.data["dispatcher"].py_func.__module__).startswith("xcg.")
        if ours and not self._announced and is_interactive():
            self._announced = True
            sys.stderr.write(_NOTICE)
        if not self._depth:
            self._was_on = gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, _: event.Event) -> None:
        self._depth -= 1
        if self._was_on and not self._depth:
            gc.enable()


event.register("numba:compile", _Compiling())  # one thread compiles at a time


def jit(function: Callable, **options: Any) -> Any:
    """Compile a loop; under ``NUMBA_DISABLE_JIT=1`` it stays the Python function that it is."""
    # the wrapper for callers in C would take a tenth of the time
    compiled = numba.njit(nogil=True, error_model="numpy", no_cfunc_wrapper=True, **options)(
        function
    )
    if CACHE and compiled is not function:
        with suppress(RuntimeError):  # no folder can be written
            compiled._cache = _Cache(function)
    return compiled


def leaf(function: Callable) -> Callable:
    """Compile a loop that makes no arrays: references to its arguments, and to views of them, are not counted.

    Counting references to memory stops the processor until all that is under way is written.
    """
    return jit(function, _nrt=False)


def inner(function: Callable, **options: Any) -> Any:
    """Compile a `leaf` that only loops call: the wrapper for calls from Python would take an eighth of the time."""
    compiled = jit(function, _nrt=False, no_cpython_wrapper=True, **options)

    def refuse(*_: Any, **__: Any) -> None:
        raise TypeError(
            f"{function.__name__} is compiled for loops; from Python, call {function.__name__}.py_func"
        )

    # what is compiled is kept for loops alone: a call from Python would end the process
    if compiled is not function:
        compiled.add_overload = lambda result: compiled.overloads.update(
            {tuple(result.signature.args): result}
        )
        compiled._compile_for_args = refuse
    return compiled


def inlined(function: Callable) -> Callable:
    """Compile a short `inner` function into the loop that calls it, where a call would take as long as itself."""
    return inner(function, forceinline=True)


T = TypeVar("T")
R = TypeVar("R")
# Fewer particles than this are not worth a second thread.
PARTICLES_A_THREAD = 20_000


def threads_for(particles: int, threads: int) -> int:
    """Return the number of threads worth starting for the particles of one step."""
    return min(threads, 1 + particles // PARTICLES_A_THREAD)


def for_each(items: Sequence[T], do: Callable[[T], R], threads: int) -> list[R]:
    """Do something with each item, in turn or by several threads; return what it gave, raise an error of theirs.

    The calling thread is one of them, from the last item on, as it has more memory at hand: see
    docs/measurements.md.
    """
    if threads == 1 or len(items) < 2:
        return list(map(do, items))
    with ThreadPoolExecutor(threads - 1) as pool:
        others = [pool.submit(do, item) for item in items]
        try:
            last = len(items) - 1
            own = {k: do(items[k]) for k in range(last, -1, -1) if others[k].cancel()}
            return [own[k] if k in own else other.result() for k, other in enumerate(others)]
        finally:
            for other in others:
                other.cancel()


def for_parts(count: int, do: Callable[[int, int], R], threads: int, each: int = 1) -> list[R]:
    """Do something with all of `count` rows, ``do(first, last)``, in `each` parts a thread; one part for one thread."""
    parts = 1
    if threads > 1:
        parts = threads * each
    cuts = [count * k // parts for k in range(parts + 1)]
    return for_each(list(pairwise(cuts)), lambda part: do(*part), threads)
