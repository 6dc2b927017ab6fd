"""The way of a call stays short: frames from the call to the loop, and functions and modules that take part."""

import json
import os
import subprocess
import sys

from tests import dumps

# outside the loops; they may fall, and not rise
MOST_FUNCTIONS, MOST_MODULES, MOST_OF_OPENING = 120, 23, 120

COUNT = """
import json, sys, warnings
from pathlib import Path
import xcg

warnings.simplefilter("ignore")
root = str(Path(xcg.__file__).parent)
seen, frames = set(), []


def depth(frame):
    count = 0
    while frame is not None:
        count += frame.f_code.co_filename.startswith(root)
        frame = frame.f_back
    return count


def watch(frame, event, argument):
    code = frame.f_code
    if event == "call" and code.co_filename.startswith(root):
        place = code.co_filename[len(root) + 1 :]
        named = not any(part.startswith("<") for part in code.co_qualname.split(".") if part != "<locals>")
        if place == "compiled/points.py" and code.co_name == "deposit":
            frames.append(depth(frame))
        if named and not place.startswith("compiled"):
            seen.add((place, code.co_qualname))


def count(work):
    sys.setprofile(watch)
    work()
    sys.setprofile(None)
    return {"functions": len(seen), "modules": len({place for place, _ in seen}), "frames": min(frames, default=0)}


"""


def counted(work, folder):
    code = f"{COUNT}{work}"
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1", "XCG_INDEX_CACHE": "0"}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_frames_and_functions_of_coarse_grain_do_not_grow(tmp_path):
    """Two fields of a profile, after a call with others, so that nothing is imported any more."""
    work = """
ds = xcg.datasets.simple_cubic(3)
ds.cg.coarse_grain(["pressure", "volume_fraction"], axes="z")
print(json.dumps(count(lambda: ds.cg.coarse_grain(["velocity", "density"], axes="z"))))
"""
    found = counted(work, tmp_path)
    assert found["frames"] <= 11
    assert found["functions"] <= MOST_FUNCTIONS
    assert found["modules"] <= MOST_MODULES


def test_functions_of_opening_two_text_files_do_not_grow(tmp_path):
    dumps.write_series(tmp_path, steps=[0])
    for path in tmp_path.iterdir():
        os.utime(path, (0, 0))  # headers of new files are not remembered
    work = """
files = {"particles": "p.0.dump", "contacts": "c.0.dump"}
xcg.open_scene(**files)
print(json.dumps(count(lambda: xcg.open_scene(**files))))
"""
    assert counted(work, tmp_path)["functions"] <= MOST_OF_OPENING
