"""Ways to damage a file: bits, blocks, lines, numbers, counts, compression."""

from __future__ import annotations

import gzip
import random
import re
import struct

NUMBERS = [
    b"-1", b"0", b"1", b"-0", b"nan", b"inf", b"-inf", b"1e308", b"-1e308", b"1e-320", b"1e30", b"-1e30", b"2147483648",
    b"4294967295", b"4294967296", b"9223372036854775807", b"9223372036854775808", b"18446744073709551615",
    b"99999999999999999999999", b"1000000000", b"1000000000000", b"0x10", b"1_0", b"1e", b"", b"x", b"1.5", b"1e9999",
    b"\xd9\xa1", b"9" * 400, b"True", b"-9223372036854775808", b"16777217",
]  # fmt: skip
PIECES = [
    b"ITEM: ", b"ITEM: TIMESTEP\n", b"ITEM: NUMBER OF ATOMS\n", b"ITEM: ATOMS id\n", b"ITEM: BOX BOUNDS pp pp pp\n",
    b"ITEM: UNITS\nlj\n", b"ITEM: TIME\nnan\n", b"#", b"# ", b"\n", b"\r", b"\r\n", b"\0", b"\t", b" ", b"\x0c",
    b"\x1c", b"\xe2\x80\xa8", b"\xff\xfe", b'"', b"'", b"<!--", b"-->", b"<", b">", b"/>", b"</Points>", b"<DataArray ",
    b"&lt;",
    b'<!DOCTYPE a [<!ENTITY b "cc">]>', b"&b;", b'format="appended"', b'format="binary"', b'format="ascii"',
    b'encoding="base64"', b'compressor="vtkZLibDataCompressor"', b'header_type="UInt64"', b'NumberOfComponents="3"',
    b'NumberOfPoints="999999999999"', b"../", b"/", b"..", b"~", b"%s", b"{step}", b"[", b"]", b"[[", b"=", b"{", b"}",
    b"density", b"gravity", b"normal", b"id", b"Particles", b"PeriodicBoundary", b"\x1f\x8b", b"_",
]  # fmt: skip


def mutate(data: bytes, rng: random.Random, others: tuple[bytes, ...] = ()) -> bytes:
    """Damage bytes in one to six ways."""
    if data[:2] == b"\x1f\x8b" and rng.random() < 0.8:  # damage what is inside
        inner = mutate(
            gzip.decompress(data),
            rng,
            tuple(gzip.decompress(o) for o in others if o[:2] == b"\x1f\x8b"),
        )
        packed = gzip.compress(inner, 1)
        return mutate_once(packed, rng, ()) if rng.random() < 0.1 else packed
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        data = mutate_once(data, rng, others)
    return data


def mutate_once(data: bytes, rng: random.Random, others: tuple[bytes, ...]) -> bytes:
    """Damage bytes in one way."""
    if not data:
        return rng.choice(PIECES)
    at = rng.randrange(len(data))
    ways = ("number",) * 5 + (
        "bit",
        "byte",
        "cut",
        "drop",
        "copy",
        "piece",
        "line",
        "integer",
        "head",
        "splice",
        "bomb",
    )
    way = rng.choice(ways)
    if way == "number":
        spots = [m.span() for m in re.finditer(rb"[-+]?\d[\d.eE+-]*", data[: 1 << 16])]
        if not spots:
            return data
        few = spots[:40] if rng.random() < 0.6 else spots
        begin, end = rng.choice(few)
        return data[:begin] + rng.choice(NUMBERS) + data[end:]
    if way == "bit":
        return data[:at] + bytes([data[at] ^ (1 << rng.randrange(8))]) + data[at + 1 :]
    if way == "byte":
        return data[:at] + bytes([rng.randrange(256)]) + data[at + 1 :]
    if way == "cut":
        return data[:at]
    if way == "drop":
        return data[:at] + data[at + rng.choice((1, 2, 8, 64, 1000)) :]
    if way == "copy":
        block = data[at : at + rng.choice((1, 8, 64, 1000))]
        return data[:at] + block * rng.choice((1, 2, 50)) + data[at:]
    if way == "piece":
        return data[:at] + rng.choice(PIECES) * rng.choice((1, 1, 1, 100)) + data[at:]
    if way == "line":
        lines = data.split(b"\n")
        one = rng.randrange(len(lines))
        two = rng.randrange(len(lines))
        lines[one], lines[two] = lines[two], rng.choice((lines[one], lines[one] * 2, b""))
        return b"\n".join(lines)
    if way == "integer":
        form = rng.choice(("<I", ">I", "<Q", ">Q"))
        most = 8 * struct.calcsize(form)
        value = rng.choice((0, 1, 2**31, 2 ** (most - 1), 2**most - 1, rng.getrandbits(most)))
        packed = struct.pack(form, value % 2**most)
        return data[:at] + packed + data[at + len(packed) :]
    if way == "head":
        head = rng.randrange(min(len(data), 2048))
        return data[:head] + rng.choice(PIECES) + data[head + rng.choice((0, 1, 4)) :]
    if way == "splice" and others:
        other = rng.choice(others)
        return data[:at] + other[rng.randrange(len(other) or 1) :]
    if way == "bomb" and rng.random() < 0.02:
        return (
            data[:at]
            + rng.choice((b" ", b"0", b"\n", b"1 ", b"<!--", b"<DataArray ", b"<")) * (1 << 21)
            + data[at:]
        )
    return data
