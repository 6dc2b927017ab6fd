"""The argument ``names=``, parsed once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

from xcg.common.messages import SceneError
from xcg.readers.names import ALL_SLOTS, CLOCK_SLOTS, canonical

_KINDS = ("particles", "contacts", "walls")
_FORMS = (
    "expected one mapping from columns to variables for all files, names={'column': 'variable'}, or one for each "
    "kind and nothing else, names={'particles': {...}, 'contacts': {...}}, or lists of all columns in their order, "
    "names={'particles': [...], 'contacts': [...]}"
)


@dataclass(frozen=True)
class CallerNames:
    """The argument ``names=``, by its form.

    Attributes
    ----------
    mapped : mapping
        From columns to variables, for files of all kinds; None drops a column.
    of_kind : mapping
        The same by kind of file ("particles", "contacts"), where the caller gives them apart.
    listed : mapping
        Names of all columns in their order (None skips one), or words of computes of LIGGGHTS, by
        kind of file ("particles", "contacts", "walls").
    """

    mapped: Mapping[str, str | None] = field(default_factory=dict)
    of_kind: Mapping[str, Mapping[str, str | None]] = field(default_factory=dict)
    listed: Mapping[str, tuple[str | None, ...]] = field(default_factory=dict)

    @classmethod
    def parse(cls, names: Mapping[str, Any] | Sequence[str | None] | str | None) -> CallerNames:
        """Return ``names=`` by its form; a text is a list of its words.

        Raises
        ------
        SceneError
            If forms are mixed, a kind or a name is not one, or a list holds a name twice.
        """
        if names is None:
            return cls()
        if isinstance(names, str):
            names = names.split()
        if isinstance(names, list | tuple):
            return cls(listed=dict.fromkeys(_KINDS, _checked(names)))
        if not isinstance(names, Mapping):
            raise SceneError(f"names={names!r}: {_FORMS}")
        mapped: dict[str, str | None] = {}
        of_kind: dict[str, Mapping[str, str | None]] = {}
        listed: dict[str, tuple[str | None, ...]] = {}
        for name, target in names.items():
            if name in _KINDS and isinstance(target, str) and len(target.split()) > 1:
                target = target.split()
            if isinstance(target, Mapping):
                of_kind[name] = dict(target)
            elif isinstance(target, list | tuple):
                listed[name] = _checked(target)
            else:
                mapped[name] = target
        variables = chain(mapped.values(), *(columns.values() for columns in of_kind.values()))
        if (
            (of_kind and (mapped or listed))
            or not of_kind.keys() <= {"particles", "contacts"}
            or not listed.keys() <= {*_KINDS}
            or not all(variable is None or isinstance(variable, str) for variable in variables)
        ):
            raise SceneError(f"names={dict(names)!r}: {_FORMS}")
        return cls(mapped, of_kind, listed)

    def own_of_lists(self) -> dict[str, str]:
        """Return the columns of lists that become variables of the caller's own, under their names."""
        aliases = {*chain(*ALL_SLOTS.values(), *CLOCK_SLOTS.values())}
        columns = filter(None, chain(*self.listed.values()))
        return {column: column for column in columns if canonical(column) not in aliases}


def _checked(names: Sequence[Any]) -> tuple[str | None, ...]:
    """Return names in their order. Raise SceneError unless they are texts that occur once, or None."""
    for name in names:
        count = list(names).count(name)
        if name is not None and (not isinstance(name, str) or count > 1):
            raise SceneError(
                f"names={list(names)!r}: {name!r} stands there {count} times; expected the name of each column "
                "once, in the order of the file, and None for a column to skip"
            )
    return tuple(names)
