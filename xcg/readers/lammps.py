"""LAMMPS text dumps: ``dump custom`` for particles, ``dump local`` for contacts, plain or gzipped."""

from __future__ import annotations

from collections.abc import Sequence

from xcg.readers import columns, dump
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.text import source_of
from xcg.scene.warn import warn_user


class Lammps(dump.Dumps):
    """Dumps of LAMMPS."""

    UNNAMED_UNITS = "have the files say it by 'dump_modify ... units yes'"

    def recognises(self, path: str) -> bool:
        """Tell LAMMPS dumps by their first lines, apart from those that only LIGGGHTS writes."""
        found = dump.body_columns(path)
        return found is not None and ".liggghts" not in path and not dump.is_numbered(found[1])

    def index_contacts(self, paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
        """List the steps of ``dump local`` files."""
        refs = dump.index_dumps(paths, options, atoms=False)
        found = self.contact_columns(refs[0], options)
        columns.warn_of_ignored(refs[0], found, columns.CONTACT_SLOTS, options)
        if "normal_force_x" in found and "tangential_force_x" not in found:
            msg = (
                f"{source_of(refs[0])}: only normal forces ({found['normal_force_x']}, ...) were found, and they are "
                "taken as the contact forces; map the others with names={'column': 'tangential_force_x', ...}"
            )
            warn_user(msg)
        return refs
