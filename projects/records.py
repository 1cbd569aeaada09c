"""Records as JSON text: parameters, counts, sources and whatever else is small and has no shape.

Standard JSON throughout: what it cannot say (NaN, infinities) is written as {"$float": "nan"}; see FORMAT.md.
"""

from __future__ import annotations

import dataclasses
import datetime
import enum
import json
import math
from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

import numpy as np

from projects.errors import StoreError

FLOAT_KEY = "$float"


def plain(value: Any, where: str = "record") -> Any:
    """Return `value` as dicts, lists, text, numbers, booleans and None; arrays become lists, tuples too.

    Raises
    ------
    StoreError
        Where a value has no such form, with the place inside the record.
    """
    if value is None or (isinstance(value, bool | str | int | float) and not isinstance(value, enum.Enum | np.generic)):
        return value
    if isinstance(value, Mapping):
        return {_key(k, where): plain(v, f"{where}/{k}") for k, v in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        items = sorted(value) if isinstance(value, set | frozenset) else value
        return [plain(v, f"{where}/{i}") for i, v in enumerate(items)]
    if isinstance(value, np.ndarray):
        return plain(value.tolist(), where)
    return plain(_simple(value, where), where)


def _simple(value: Any, where: str) -> Any:
    """Return the plain value that stands for one of the few other types which records hold."""
    if isinstance(value, enum.Enum):
        return value.value
    if isinstance(value, np.bool_ | np.integer | np.floating | np.str_):
        return value.item()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
    if isinstance(value, datetime.datetime | datetime.date):
        return value.isoformat()
    if isinstance(value, PurePath):
        return value.as_posix()
    raise StoreError(f"{where}: a {type(value).__name__} cannot be kept in a record; give numbers, text or arrays")


def _key(key: Any, where: str) -> str:
    """Return a key of a record; refuse what cannot be one."""
    if not isinstance(key, str) or key == FLOAT_KEY:
        raise StoreError(f"{where}: {key!r} cannot be a record's key; text is needed, and not {FLOAT_KEY!r}")
    return str(key)


def to_json(value: Any) -> str:
    """Return `value` as one line of standard JSON in UTF-8, keys in their order."""
    return _dumps(_floats_out(plain(value)))


def canonical_json(value: Any) -> str:
    """Return the JSON that is hashed: keys sorted, whole floats as integers, so that 5 and 5.0 ask the same."""
    return _dumps(_floats_out(_whole(plain(value))), sort_keys=True)


def from_json(text: str, where: str = "record") -> Any:
    """Return the value of `to_json`; raise `StoreError` where the text is not JSON."""
    try:
        return _floats_in(json.loads(text))
    except (ValueError, RecursionError) as error:
        raise StoreError(f"{where}: a damaged record ({error})") from error


def _dumps(value: Any, *, sort_keys: bool = False) -> str:
    """Return compact JSON in UTF-8."""
    text = json.dumps(value, ensure_ascii=False, allow_nan=False, sort_keys=sort_keys, separators=(",", ":"))
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:  # a file name that is not UTF-8 arrives as lone surrogates; escaped it survives
        return json.dumps(value, allow_nan=False, sort_keys=sort_keys, separators=(",", ":"))
    return text


def _floats_out(value: Any) -> Any:
    """Return a value with infinite and unknown numbers as JSON can say them."""
    if isinstance(value, dict):
        return {k: _floats_out(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_floats_out(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return {FLOAT_KEY: repr(value)}
    return value


def _floats_in(value: Any) -> Any:
    """Return a value with infinite and unknown numbers as they were."""
    if isinstance(value, dict):
        if value.keys() == {FLOAT_KEY}:
            return float(value[FLOAT_KEY])
        return {k: _floats_in(v) for k, v in value.items()}
    return [_floats_in(v) for v in value] if isinstance(value, list) else value


def _whole(value: Any) -> Any:
    """Return a value with whole numbers as integers, so that 1 and 1.0 have one hash."""
    if isinstance(value, dict):
        return {k: _whole(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_whole(v) for v in value]
    return int(value) if isinstance(value, float) and value.is_integer() else value
