"""Every decision about compilation, in one place.

Kernels release the GIL, so that dask's threads run them side by side; they are serial, because a parallel
kernel under a threaded scheduler aborts the interpreter. Floating-point code may contract and reassociate, but
keeps NaN and infinity; `exact` keeps every rounding as written, for decisions that must not depend on the compiler,
such as whether two spheres touch. Compiled code is kept on disk, so that a second process starts at once; set
``XCG_JIT_CACHE=0`` where processes on different machines share the installation directory.
"""

import os

import numba

CACHE = os.environ.get("XCG_JIT_CACHE", "1") != "0"

jit = numba.njit(nogil=True, cache=CACHE, error_model="numpy", fastmath={"contract", "nsz", "arcp", "reassoc"})
inline = numba.njit(nogil=True, cache=CACHE, error_model="numpy", inline="never")
exact = numba.njit(nogil=True, cache=CACHE, error_model="numpy")
