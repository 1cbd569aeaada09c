"""Texts that people give, names and labels: every character of them is to be seen where they are shown.

In: texts by what they are. Out: nothing, or an error that names the character.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Iterator

from projects.errors import ParameterError

UNSEEN = ("Cc", "Cf", "Zl", "Zp")  # controls, formats such as U+202E that turns the order of letters, ends of lines
JOINERS = "\u200c\u200d"  # Persian and the scripts of India are not written rightly without
LINES = "\t\n\r"  # a description may have several
TEXTS = ("name", "description", "inventory", "place", "material", "label", "operator")


def require_visible(record: object, what: str) -> None:
    """Raise `ParameterError` where a text of a record, of those that people give, holds a character that is not seen.

    Parameters
    ----------
    record : of an object or an epoch, or whatever has some of `TEXTS`.
    what : the words for it in messages, such as "object stove".
    """
    for name in TEXTS:
        text = str(getattr(record, name, ""))
        unseen = next(_unseen(text, LINES if name == "description" else ""), None)
        if unseen is not None:
            known = unicodedata.name(unseen, "a control character").lower()
            raise ParameterError(
                f"the {name} of {what}, {text[:60]!r}, holds U+{ord(unseen):04X} ({known}), which is not seen where it "
                "is shown, and may change what is read there; give it in letters, digits, signs and spaces alone"
            )


def _unseen(text: str, allowed: str) -> Iterator[str]:
    """Yield the characters of a text that are not seen."""
    return (c for c in text if unicodedata.category(c) in UNSEEN and c not in JOINERS + allowed)
