"""Numbers as bits: rounded to some of their digits, and their bytes in the order that compresses best."""

import numpy as np

from xcg.compiled._jit import leaf

_BLOCK = 4096  # numbers that stay in the processor's first cache while their bytes are taken apart


@leaf
def round_bits(bits, drop, special):
    """Round floating-point numbers, given as integers (n,), to nearest even without their last `drop` bits.

    Numbers whose bits `special` are all set are infinite or NaN and stay as they are.
    """
    one = bits.dtype.type(1)
    half, mask = (one << (drop - one)) - one, ~((one << drop) - one)
    for n in range(bits.size):
        x = bits[n]
        if x & special != special:
            bits[n] = (x + half + ((x >> drop) & one)) & mask


@leaf
def shuffle_bytes(numbers, out):
    """Write the lowest bytes of unsigned integers (n,), then their second bytes, ...: out (bytes of a number, n)."""
    eight, byte = numbers.dtype.type(8), numbers.dtype.type(255)
    for first in range(0, numbers.size, _BLOCK):
        end = min(first + _BLOCK, numbers.size)
        shift = numbers.dtype.type(0)
        for k in range(out.shape[0]):
            for n in range(first, end):
                out[k, n] = np.uint8((numbers[n] >> shift) & byte)
            shift += eight
