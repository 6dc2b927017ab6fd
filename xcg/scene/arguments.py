"""Arguments that a function does not have, before it is called: which one was meant."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from typing import Any

from xcg.scene.schema import did_you_mean


def check_arguments(name: str, signature: inspect.Signature, args: Sequence[Any], options: Mapping[str, Any]) -> None:
    """Refuse a call that a signature does not fit.

    Raises
    ------
    TypeError
        If an argument is unknown, missing or one too many; where the name of another is similar, it says which.
    """
    known = signature.parameters
    open_ended = any(p.kind is inspect.Parameter.VAR_KEYWORD for p in known.values())
    for word in options:
        if word not in known and not open_ended:
            msg = f"{name}() got an unexpected keyword argument {word!r}{did_you_mean(word, known)}"
            raise TypeError(msg)
    try:
        signature.bind(*args, **options)
    except TypeError as error:
        msg = f"{name}(): {error}"
        raise TypeError(msg) from None
