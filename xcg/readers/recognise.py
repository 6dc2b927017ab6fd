"""Choice of the engine that reads a file, by its first bytes and its name."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

from xcg.common.messages import SceneError
from xcg.readers.engine import Engine, all_engines, engine_table
from xcg.readers.unread import refuse_unread
from xcg.steps import faults as errors
from xcg.steps.faults import FAULTS


def guess_engine(files: Mapping[str, Sequence[str]]) -> Engine:
    """Return the first engine that recognises the first file of each kind; where faults are tolerated, a good one."""
    firsts = [paths[0] for paths in files.values()]
    if errors.recorded() is not None:
        firsts = [next(filter(is_recognised, paths), paths[0]) for paths in files.values()]
    for engine in all_engines():
        if all(engine.recognises(path) for path in firsts):
            return engine
    empty = [path for path in firsts if not os.path.getsize(path)]
    if empty:
        raise SceneError(
            f"{empty[0]}: the file is empty; write it again, or leave it out (on_error='skip')"
        )
    for path in firsts:
        if not is_recognised(path):
            refuse_unread(path)
    raise SceneError(
        f"no engine recognises {' with '.join(firsts)}; name one with engine=: "
        f"{', '.join(engine_table())}. Tables of numbers without a line of names need "
        "names=['id', 'x', 'y', 'z', ...] in the order of the columns. For other formats, "
        "xcg.scene_from_arrays takes arrays, and engine= a reader of your own (docs/custom.md)"
    )


def is_recognised(path: str) -> bool:
    """Return whether any engine reads a file; False if it is damaged."""
    try:
        return any(engine.recognises(path) for engine in all_engines())
    except FAULTS:
        return False
