"""Ids of objects and epochs, names of products, and the one function that turns them into file names.

An id comes from a user or a file; what leaves here cannot name anything outside of the project.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable
from pathlib import PurePosixPath

from projects.errors import ParameterError, StoreError

ID_PATTERN = re.compile(r"[A-Za-z0-9][A-Za-z0-9.-]{0,63}")
KIND_PATTERN = re.compile(r"[a-z][a-z0-9_]{0,31}")
STEP_PATTERN = re.compile(r"[0-9a-f]{8,64}")
PRODUCT_FILE_PATTERN = re.compile(r"[a-z][a-z0-9_]{0,31}(-[A-Za-z0-9][A-Za-z0-9.-]{0,63})?-[0-9a-f]{8,64}\.h5")
WINDOWS_DEVICES = re.compile(r"(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?", re.IGNORECASE)
TAKEN = ("series",)  # stands in an epoch's place in names of exported files
TRANSLITERATED = str.maketrans(
    {"ä": "ae", "ö": "oe", "ü": "ue", "Ä": "Ae", "Ö": "Oe", "Ü": "Ue", "ß": "ss", "ẞ": "SS", "æ": "ae", "ø": "oe",
     "å": "aa", "Æ": "Ae", "Ø": "Oe", "Å": "Aa", "œ": "oe", "Œ": "Oe", "ł": "l", "Ł": "L", "đ": "d", "Đ": "D"}
)  # fmt: skip


def comparison_product(reference_id: str) -> str:
    """Return the name under which an epoch keeps its comparison with an earlier one."""
    return f"comparison-{reference_id}"


def series_product(first_id: str) -> str:
    """Return the name under which an epoch keeps the series that begins with an earlier one."""
    return f"series-{first_id}"


def scan_product(number: int) -> str:
    """Return the name under which an epoch keeps a filtered scan, the first being 0."""
    return f"scan{number:03d}"


def require_id(text: str, what: str) -> str:
    """Return `text` if it is an id of an object or epoch; raise `ParameterError` with a suggestion otherwise.

    Parameters
    ----------
    text : the id as the user gave it.
    what : the word for it in messages, "object" or "epoch".
    """
    if isinstance(text, str) and ID_PATTERN.fullmatch(text):
        return text
    free = "--label" if what.lower() == "epoch" else "--name"
    raise ParameterError(
        f"{what} id {_shown(text)} {_fault(text)}; allowed are letters a-z A-Z, digits, '.' and '-', first a letter "
        f"or digit, at most 64: for example {suggest_id(text, what)!r} (free text belongs in {free})"
    )


def require_epoch_id(text: str) -> str:
    """Return `text` if an epoch may be called so: an id that stands for nothing else in names of exported files."""
    require_id(text, "epoch")
    if text.lower() in TAKEN:
        raise ParameterError(
            f"epoch id {text!r} stands for change over all epochs in names of exported files, where the epoch's own "
            f"would be the same; choose another id, such as {text + '-1'!r}"
        )
    return text


def require_new_id(text: str, existing: Iterable[str], what: str) -> str:
    """Return `text` if it is an id and no existing one equals it, with or without regard to upper and lower case."""
    text = require_epoch_id(text) if what == "epoch" else require_id(text, what)
    for other in existing:
        if other == text:
            raise StoreError(f"{what} {text!r} exists already; choose another id")
        if other.lower() == text.lower():
            raise StoreError(
                f"{what} id {text!r} differs only in upper and lower case from the existing {other!r}, which some "
                f"file systems cannot tell apart; use {other!r} or choose another id"
            )
    return text


def suggest_id(text: str, what: str = "object") -> str:
    """Return an allowed id that resembles `text`: umlauts written out, accents dropped, the rest as '-'."""
    plain = unicodedata.normalize("NFKD", unicodedata.normalize("NFC", str(text)).translate(TRANSLITERATED))
    plain = "".join(c for c in plain if not unicodedata.combining(c))
    plain = re.sub(r"[^A-Za-z0-9.]+", "-", plain)
    plain = re.sub(r"-*\.[-.]*", ".", re.sub(r"-+", "-", plain)).strip("-.")
    return plain[:64].rstrip("-.") or f"{what}-1"


def split_product(product: str) -> tuple[str, str | None]:
    """Return (kind, reference id or None) of a product name, `surface` or `comparison-E1`; raise where it is neither.

    A kind has no '-', so the first one ends it even where the reference's id holds more of them.
    """
    kind, dash, reference = str(product).partition("-")
    if not KIND_PATTERN.fullmatch(kind) or (dash and not ID_PATTERN.fullmatch(reference)):
        raise ParameterError(
            f"product {_shown(product)} is not a product name; allowed is a word of a-z, 0-9 and '_', or such a word, "
            "'-' and the id of the reference epoch, for example 'surface' or 'comparison-E1'"
        )
    return kind, reference if dash else None


def require_step_id(step_id: str) -> str:
    """Return `step_id` if it is 8 to 64 hexadecimal digits; raise `ParameterError` otherwise."""
    if not isinstance(step_id, str) or not STEP_PATTERN.fullmatch(step_id):
        raise ParameterError(
            f"step id {_shown(step_id)}: 8 to 64 digits 0-9 a-f are needed (projects.provenance.step_id)"
        )
    return step_id


def product_file(object_id: str, epoch_id: str, product: str, step_id: str) -> PurePosixPath:
    """Return the product's file relative to the project folder; the only place where names become file names.

    Every part is checked here, whoever called: none can hold a separator or a leading dot, so the path stays inside.
    """
    split_product(product)
    require_step_id(step_id)
    return epoch_folder(object_id, epoch_id) / f"{product}-{step_id}.h5"


def product_of_file(name: str) -> tuple[str, str | None]:
    """Return (kind, reference id or None) of the product that a file of this name holds."""
    return split_product(name.removesuffix(".h5").rpartition("-")[0])


def epoch_folder(object_id: str, epoch_id: str) -> PurePosixPath:
    """Return the folder of an epoch relative to the project folder."""
    return object_folder(object_id) / _folder(require_id(epoch_id, "epoch"))


def object_folder(object_id: str) -> PurePosixPath:
    """Return the folder of an object relative to the project folder."""
    return PurePosixPath("objects") / _folder(require_id(object_id, "object"))


def _folder(identifier: str) -> str:
    """Return the folder's name of an id: with '_', which is in no id, where Windows would take it for another name."""
    before = "_" if WINDOWS_DEVICES.fullmatch(identifier) else ""
    return before + identifier + ("_" if identifier.endswith(".") else "")


def _shown(text: object) -> str:
    """Return `text` for a message: one line, escaped, not longer than a line."""
    shown = repr(text)
    return shown if len(shown) <= 80 else shown[:76] + "...'"


def _fault(text: object) -> str:
    """Return what is wrong with an id, in words; a look-alike letter is named, since the eye cannot tell it."""
    if not isinstance(text, str):
        return "is not text"
    if not text:
        return "is empty"
    bad = next((c for c in text if not re.fullmatch(r"[A-Za-z0-9.-]", c)), None)
    if bad is None:
        return "begins with '.' or '-'" if text[0] in ".-" else f"has {len(text)} characters"
    return f"holds {bad!r} ({unicodedata.name(bad, 'a control character').lower()})"
