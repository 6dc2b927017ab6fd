"""Hidden folders of runs: what their incomplete files are of, and which steps are in them."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from dask.base import tokenize

from xcg.common.messages import SceneError
from xcg.writers.encoding import Encoding
from xcg.writers.files import remove


class Mismatch(SceneError):
    """An interrupted run was of another scene or call; `folder` holds what it wrote, `changed` says what differs."""

    def __init__(self, folder: Path, changed: Sequence[str]) -> None:
        super().__init__(
            f"{folder} is of a save that was interrupted, of another scene or call ({'; '.join(changed)}); "
            "repeat the call that began it, or remove the folder to start over"
        )
        self.folder = folder
        self.changed = changed

    def __reduce__(self) -> tuple[type[Mismatch], tuple[Path, Sequence[str]]]:
        return Mismatch, (self.folder, self.changed)


@dataclass(frozen=True)
class Begun:
    """Hidden folder with the incomplete files of a run, and with its state.

    ``state.json`` says that the files are laid out, and of what; ``whole`` that they hold all steps
    and only lack their names.
    """

    folder: Path

    def matches(self, state: Mapping[str, str]) -> bool:
        """Return whether the files are laid out; raise Mismatch where they are of something else."""
        file = self.folder / "state.json"
        if not file.exists():
            return False
        before = json.loads(file.read_text())
        changed = [
            f"{key}: {_short(state.get(key, 'none'))} instead of {_short(before.get(key, 'none'))}"
            for key in sorted({*before, *state})
            if before.get(key) != state.get(key)
        ]
        if changed:
            raise Mismatch(self.folder, changed)
        return True

    def clear(self) -> None:
        """Remove what a run left that was killed while it laid out the files."""
        for path in self.folder.iterdir():
            remove(path)

    def begin(self, state: Mapping[str, str]) -> None:
        """Record that the files are laid out."""
        part = self.folder / "state.part"
        part.write_text(json.dumps(state))
        os.replace(part, self.folder / "state.json")

    def end(self) -> None:
        """Record that the files hold all steps."""
        (self.folder / "whole").touch()

    def is_whole(self) -> bool:
        """Return whether the files hold all steps; some may have their names already."""
        return (self.folder / "whole").exists()

    def log(self, output: int) -> Log:
        """Return the log of an output, by its index among all."""
        return Log(self.folder / f"done_{output}.jsonl")


@dataclass(frozen=True)
class Log:
    """Log of the steps in the files of an output. Tasks record a chunk of them when all files hold it."""

    file: Path

    def add(self, steps: slice, skipped: Mapping[int, str]) -> None:
        """Record that steps are in all files, and why some of them were skipped."""
        self._write({"steps": [steps.start, steps.stop], "skipped": skipped})

    def add_cause(self, step: int, cause: str) -> None:
        """Record why a step with this number was skipped in another process, where nobody listens."""
        self._write({"steps": [0, 0], "skipped": {}, "causes": {step: cause}})

    def _write(self, line: Mapping[str, Any]) -> None:
        with open(self.file, "ab", buffering=0) as file:
            file.write(f"\n{json.dumps(line)}".encode())

    def steps(self) -> set[tuple[int, int]]:
        """First and last (exclusive) step of each chunk that is there."""
        return {tuple(line["steps"]) for line in self._lines()}

    def skipped(self) -> dict[int, str]:
        """Return the steps that were skipped, by their index in time, and why."""
        return dict(
            sorted(
                (int(t), cause) for line in self._lines() for t, cause in line["skipped"].items()
            )
        )

    def causes(self) -> dict[int, str]:
        """Return the causes that other processes sent, by number of the step."""
        causes = (line.get("causes", {}) for line in self._lines())
        return {int(step): cause for line in causes for step, cause in line.items()}

    def _lines(self) -> Iterator[dict[str, Any]]:
        if not self.file.exists():
            return
        for line in self.file.read_text().splitlines():
            if line.endswith("}}"):  # else the process ended while it wrote the line
                yield json.loads(line)


def state_of(ds: xr.Dataset, encoding: Encoding, formats: Sequence[str]) -> dict[str, str]:
    """Describe what is written, by names that a message can use.

    Names of dask's tasks represent lazy values: they follow from the files, as they were when they
    were opened, and from the call.
    """
    state = {"xcg": version("xcg"), "formats": ", ".join(formats), "encoding": str(encoding)}
    for name, data in ds.variables.items():
        state[f"shape of {name!r}"] = f"{dict(data.sizes)} {data.dtype}"
        if data.chunks is None:
            state[f"values of {name!r}"] = tokenize(data.to_numpy())
        else:
            state[f"values of {name!r}"] = data.data.name
    for name, value in ds.attrs.items():
        if name != "history":  # which has the time of the call
            state[f"attribute {name!r}"] = str(np.asarray(value).tolist())
    return state


def _short(text: str) -> str:
    if len(text) < 60:
        return text
    return f"{text[:57]}..."
