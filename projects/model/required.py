"""The check that a value handed to the library is the noun that it should be."""

from __future__ import annotations

from typing import Any

from projects.errors import ParameterError


def require_noun(value: Any, what: str, *nouns: type) -> None:
    """Raise `ParameterError` where the value, which stands for `what`, is none of the nouns."""
    if not isinstance(value, nouns):
        names = " or ".join(noun.__name__ for noun in nouns)
        raise ParameterError(f"{what} is a {type(value).__name__}; a {names} is needed")
