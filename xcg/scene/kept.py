"""Things that are kept for the next time they are wanted."""

from __future__ import annotations

from collections import UserDict
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Any, TypeVar

T = TypeVar("T")
_changing = Lock()


class Kept(UserDict[Hashable, T]):
    """Things by what they were made from, no more than `most` of them: for one more the oldest goes.

    They stay behind where what holds them travels to another process.
    """

    def __init__(self, most: int) -> None:
        super().__init__()
        self.most = most

    def or_new(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return what is kept, or make and keep it."""
        found = self.data.get(key)
        if found is None:
            found = make()
            self.keep(key, found)
        return found

    def keep(self, key: Hashable, thing: T) -> None:
        """Keep one thing more."""
        with _changing:
            while len(self.data) >= self.most:
                self.data.pop(next(iter(self.data)), None)
            self.data[key] = thing

    def __reduce__(self) -> tuple[Any, ...]:
        return Kept, (self.most,)
