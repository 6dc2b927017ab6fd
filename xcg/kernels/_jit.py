"""Every decision about compilation, in one place.

Kernels release the GIL, so that dask's threads run them side by side; they are serial, because a parallel kernel
under a threaded scheduler aborts the interpreter. Arithmetic is strict: the compiler may neither reorder nor contract
it, so that results have the same bits in every process and at every number of threads.

Compiled code is kept on disk beside the sources, so that a second process starts at once; ``XCG_JIT_CACHE=0`` turns
that off, for example where machines of different kinds share an installation.
"""

import hashlib
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numba

# Threads for a single step in memory (NUMBA_NUM_THREADS, else the processors of this process).
THREADS = numba.config.NUMBA_NUM_THREADS
CACHE = os.environ.get("XCG_JIT_CACHE", "1") != "0"


def _forget_stale_code() -> None:
    """Delete compiled code that is older than any kernel.

    Numba looks at the file of the function alone, but code from other files is compiled into it.
    """
    here = Path(__file__).parent
    digest = hashlib.sha256(numba.__version__.encode())
    for source in sorted(here.glob("*.py")):
        digest.update(source.read_bytes())
    stamp = here / "__pycache__" / "kernels.digest"
    with suppress(OSError):  # a read-only installation never changes
        if not stamp.exists() or stamp.read_text() != digest.hexdigest():
            for compiled in stamp.parent.glob("*.nb[ic]"):
                compiled.unlink(missing_ok=True)
            stamp.parent.mkdir(exist_ok=True)
            stamp.write_text(digest.hexdigest())


if CACHE:
    _forget_stale_code()


def jit(function: Callable, **options: Any) -> Callable:
    """Compile a kernel."""
    # the wrapper for callers in C would take a tenth of the time
    return numba.njit(nogil=True, cache=CACHE, error_model="numpy", no_cfunc_wrapper=True, **options)(function)


def leaf(function: Callable) -> Callable:
    """Compile a kernel that makes no arrays: those that it is given, and views of them, are not counted.

    Counting references to memory stops the processor until all that is under way is written.
    """
    return jit(function, _nrt=False)
