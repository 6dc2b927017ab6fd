"""Hidden folders of files that are not whole yet: what they are of, and which steps are in them."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from dask.base import tokenize

from xcg.common.messages import SceneError
from xcg.writers.encoding import Encoding
from xcg.writers.files import locked, part_of, remove_for_good, temporary


class Mismatch(SceneError):
    """An interrupted run was of another scene or call; `folder` holds what it wrote."""

    def __init__(self, folder: Path, message: str) -> None:
        super().__init__(message)
        self.folder = folder


@contextmanager
def work_folder(kept: Path | None, path: Path | None) -> Iterator[Path]:
    """Give a folder for files that are not whole yet, which goes in the end.

    Parameters
    ----------
    kept : Path or None
        A folder that stays after an error, held by one process at a time; None for a temporary one beside `path`.

    Raises
    ------
    FileExistsError
        If another process holds it.
    """
    if kept is not None:
        what = kept.name.removeprefix(".").removesuffix(".begun")
        with locked(kept.with_name(f"{kept.name}.lock"), str(kept.with_name(what))):
            kept.mkdir(exist_ok=True)
            yield kept
            gone = part_of(kept)
            kept.rename(gone)  # at once, so that no half of it is taken for a run to go on with
            shutil.rmtree(gone)
        return
    assert path is not None
    work = part_of(path)
    temporary.add(work)
    try:
        work.mkdir()
        yield work
    finally:
        remove_for_good(work)
        temporary.discard(work)


@dataclass(frozen=True)
class Log:
    """Which steps are in the files of a folder. Tasks note a chunk of them when all files hold it."""

    folder: Path

    def is_begun(self, state: Mapping[str, str]) -> bool:
        """Whether the files are laid out; raise Mismatch where they are of something else."""
        file = self.folder / "state.json"
        if not file.exists():
            return False
        before = json.loads(file.read_text())
        wrong = [key for key in sorted({*before, *state}) if before.get(key) != state.get(key)]
        if wrong:
            told = "; ".join(f"{key}: {_short(state.get(key))} instead of {_short(before.get(key))}" for key in wrong)
            raise Mismatch(
                self.folder,
                f"{self.folder} is of a save that was interrupted, of another scene or call ({told}); repeat the call "
                "that began it, or remove the folder to start over",
            )
        return True

    def begin(self, state: Mapping[str, str]) -> None:
        """Note that the files are laid out."""
        part = self.folder / "state.part"
        part.write_text(json.dumps(state))
        os.replace(part, self.folder / "state.json")

    def add(self, steps: slice, skipped: Mapping[int, str]) -> None:
        """Note that steps are in all files, and why some of them were skipped."""
        line = json.dumps({"steps": [steps.start, steps.stop], "skipped": skipped})
        with open(self.folder / "done.jsonl", "ab", buffering=0) as file:
            file.write(f"\n{line}".encode())

    def steps(self) -> set[tuple[int, int]]:
        """First and last (exclusive) step of each chunk that is there."""
        return {(first, stop) for first, stop in (line["steps"] for line in self._lines())}

    def skipped(self) -> dict[int, str]:
        """Return the steps that were skipped, by their place in time, and why."""
        return dict(sorted((int(t), cause) for line in self._lines() for t, cause in line["skipped"].items()))

    def _lines(self) -> Iterator[dict[str, Any]]:
        file = self.folder / "done.jsonl"
        for line in file.read_text().splitlines() if file.exists() else ():
            if line.endswith("}}"):  # else the process ended while it wrote the line
                yield json.loads(line)


def state_of(ds: xr.Dataset, encoding: Encoding, formats: Sequence[str], mark: str) -> dict[str, str]:
    """Describe what is written, by names that a message can use.

    Names of dask's tasks stand for lazy values: they follow from the files, as they were when they were opened, and
    from the call.
    """
    state = {"xcg": version("xcg"), "formats": ", ".join(formats), "encoding": str(encoding), "job": mark}
    for name, data in ds.variables.items():
        state[f"shape of {name!r}"] = f"{dict(data.sizes)} {data.dtype}"
        state[f"values of {name!r}"] = data.data.name if data.chunks is not None else tokenize(data.to_numpy())
    attrs = {name: value for name, value in ds.attrs.items() if name != "history"}  # which has the time of the call
    return state | {f"attribute {name!r}": str(np.asarray(value).tolist()) for name, value in attrs.items()}


def _short(text: str | None) -> str:
    return "none" if text is None else text if len(text) < 60 else f"{text[:57]}..."
