"""One damaged set of files through one target: opened, refused in the package's own words, or a failure."""

from __future__ import annotations

import random
import resource
import shutil
import traceback
import warnings
from collections.abc import Mapping
from pathlib import Path

from tests import ROOT
from tests.fuzz.targets import TARGETS
from xcg import SceneError, SceneWarning

_OWN = str(ROOT / "xcg")


def damaged(name: str, seeds: Mapping[str, bytes], rng: random.Random) -> dict[str, bytes]:
    """Damage one file of a set."""
    files = dict(seeds)
    chosen = rng.choice(sorted(set(files) - TARGETS[name].fixed))
    others = tuple(data for other, data in files.items() if other != chosen)
    files[chosen] = TARGETS[name].damage(files[chosen], rng, others)
    return files


def lay(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write a set of files into an empty folder."""
    shutil.rmtree(folder, ignore_errors=True)
    for name, data in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)


def outcome(name: str, folder: Path) -> tuple[str, str]:
    """Use the files in a folder: "opened", "refused", or "failed" with what went wrong."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SceneWarning)
            TARGETS[name].use(folder)
    except (SceneError, ValueError, OSError) as error:
        if not is_own(error):
            return "failed", "".join(traceback.format_exception(error)[-12:])
        if not isinstance(error, (SceneError, OSError)) and not _from_arguments(error):
            return (
                "failed",
                f"not the package's own error: {error!r}\n{traceback.format_exc()[-1500:]}",
            )
        return "refused", str(error)
    except MemoryError:
        # a job may ask for more nodes than fit, which the command says in its own words; its data are never damaged
        return ("refused" if name in ("ini", "toml") else "failed"), traceback.format_exc()[-3000:]
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        return "failed", traceback.format_exc()[-3000:]
    return "opened", ""


def address_space() -> int:
    """Bytes of memory that this process has asked for."""
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


def is_own(error: Exception) -> bool:
    """Whether an error was raised by the package, outside its compiled loops."""
    last = traceback.extract_tb(error.__traceback__)[-1].filename
    return last.startswith(_OWN) and "/compiled/" not in last


# modules that check arguments
_CHECKS = (
    "checks", "grid", "layout", "plan", "coarse_grain", "kernels", "find_contacts", "pairs",
    "slice_temperature", "phases", "config", "toml_config", "pysammos_config", "pysammos", "registry",
    "build", "scene", "sizes", "complete",
)  # fmt: skip


def _from_arguments(error: Exception) -> bool:
    """Whether a plain ValueError is of the checks of arguments, which have no file to name."""
    module = Path(traceback.extract_tb(error.__traceback__)[-1].filename).stem
    return module in _CHECKS
