"""How a setting is declared: its default, unit, meaning and range, written once on the dataclass that holds it.

Used by the settings of every step; `monitor.settings` gathers them and turns them into TOML and back.
"""

from __future__ import annotations

import dataclasses
import math
import numbers
from typing import Any, TypeVar

import numpy as np

from projects.errors import ParameterError

T = TypeVar("T")


def setting(
    default: Any, *, unit: str, meaning: str, low: float | None = None, high: float | None = None,
    choices: tuple[str, ...] = (),
) -> Any:  # fmt: skip
    """Declare one setting: `unit` is empty where it has none, `low` and `high` are the least and greatest allowed.

    `default` None means: found from the data (written "auto" in TOML).
    """
    metadata = {"unit": unit, "meaning": meaning, "low": low, "high": high, "choices": choices}
    return dataclasses.field(default=default, metadata=metadata)


def check_settings(settings: Any) -> None:
    """Raise `ParameterError` where a value is of another kind than declared or outside of its range; call it in
    `__post_init__`."""
    for f in dataclasses.fields(settings):
        value, meta = getattr(settings, f.name), f.metadata
        if meta and value is not None:
            _check_value(f"{type(settings).__name__}.{f.name} = {value!r}", value, f)


def given_or_default(settings: Any, kind: type[T]) -> T:
    """Return the settings given, or the defaults of their `kind` where left out (None).

    Raises
    ------
    ParameterError
        Where they are of another kind, as a dict of values.
    """
    if settings is None:
        return kind()
    if not isinstance(settings, kind):
        name = kind.__name__
        raise ParameterError(
            f"settings: a {type(settings).__name__} was given; a {name} is needed, as {name}(), or None"
        )
    return settings


def _check_value(told: str, value: Any, field: dataclasses.Field[Any]) -> None:
    """Raise `ParameterError` where one value cannot be."""
    meta, kinds = field.metadata, str(field.type).split(" | ")
    if meta["choices"]:
        if value not in meta["choices"]:
            raise ParameterError(f"{told}: allowed are {', '.join(meta['choices'])}")
        return
    if "bool" in kinds:
        if not isinstance(value, bool | np.bool_):
            raise ParameterError(f"{told}: allowed are true and false")
        return
    low, high = meta["low"], meta["high"]
    if low is None and high is None:
        return
    number = numbers.Integral if "int" in kinds else numbers.Real
    if not isinstance(value, number) or isinstance(value, bool):
        raise ParameterError(f"{told}: a {'whole ' if number is numbers.Integral else ''}number is needed")
    is_finite = abs(value) != math.inf
    if not is_finite or not ((low is None or value >= low) and (high is None or value <= high)):  # NaN is in no range
        unit = f" {meta['unit']}" if meta["unit"] else ""
        span = f"at least {low}" if high is None else f"at most {high}" if low is None else f"{low} to {high}"
        finite = "" if is_finite else ", and finite"
        raise ParameterError(f"{told}{unit}: allowed is {span}{finite}")
