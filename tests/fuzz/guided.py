"""Fuzz one file of a target, guided by the branches it reaches: ``python -m tests.fuzz.guided mercury run.data``.

Needs atheris. Arguments after the two names go to libFuzzer, as ``-max_total_time=600``. Bodies are not computed on:
what is guided are the readers. Failures are kept as ``crash-...`` in the working folder.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["xcg.readers", "xcg.jobs"]):
    pass

from tests.fuzz import targets
from tests.fuzz.check import lay, outcome


def main() -> None:
    """Run from the command line."""
    name, file, *options = sys.argv[1:]
    folder = Path(tempfile.mkdtemp(prefix="xcg-guided-"))
    seeds = targets.TARGETS[name].seeds(folder)
    corpus = folder / "corpus"
    corpus.mkdir()
    (corpus / "seed").write_bytes(seeds[file])
    targets.fields_of = lambda ds, **_: ds.load(scheduler="synchronous")

    def one(data: bytes) -> None:
        lay(folder / "now", {**seeds, file: data})
        result, detail = outcome(name, folder / "now")
        if result == "failed":
            raise RuntimeError(detail)

    atheris.Setup([sys.argv[0], *options, "-timeout=30", "-rss_limit_mb=4096", str(corpus)], one)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
