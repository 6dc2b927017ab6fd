"""Tests mirror the package: what tests `xcg/<room>/<module>.py` is `tests/<room>/test_<module>.py`."""

from tests import ROOT

# folders of tests across rooms
ACROSS = {"architecture", "benchmarks", "codes", "docs", "fuzz", "identities", "stability"}
# files of the kinds that people post, by what is read from them
PUBLIC = ("readers", "public")
# files with another name, and what they test
OTHERS = {
    "compiled/test_references.py": "points and segments, both against their references in NumPy",
    "compiled/test_uncompiled.py": "all loops, in Python and compiled",
    "fields/formulas/rows/test_temperature.py": "granular temperature, from sums and a fit to averages",
    "readers/test_bounded.py": "limits on what files ask for, in texts, compressed files and the index",
    "scene/test_plausible.py": "warnings about implausible input, of scenes, calls and files",
    "steps/test_distributed.py": "the functions of all rooms under a cluster of processes",
    "steps/test_memory.py": "memory of readers, steps, sums and writers",
    "test_cli.py": "the commands, as users type them",
}


def test_files_have_the_names_of_modules():
    others = set()
    for path in (ROOT / "tests").rglob("test_*.py"):
        place = path.relative_to(ROOT / "tests")
        room = ROOT / "xcg" / place.parent
        module = place.stem.removeprefix("test_")
        if place.parts[0] in ACROSS or place.parts[:2] == PUBLIC:
            continue
        if not any((room / f"{p}{module}.py").exists() for p in ("", "_")):
            others.add(place.as_posix())
    assert others == set(OTHERS)
