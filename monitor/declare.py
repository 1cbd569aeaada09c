"""How a setting is declared: its default, unit, meaning and range, written once on the dataclass that holds it.

Used by the settings of every step; `monitor.settings` gathers them and turns them into TOML and back.
"""

from __future__ import annotations

import dataclasses
from typing import Any

from projects.errors import ParameterError


def setting(
    default: Any, *, unit: str, meaning: str, low: float | None = None, high: float | None = None,
    choices: tuple[str, ...] = (),
) -> Any:  # fmt: skip
    """Declare one setting. `default` None means: found from the data (written "auto" in TOML)."""
    metadata = {"unit": unit, "meaning": meaning, "low": low, "high": high, "choices": choices}
    return dataclasses.field(default=default, metadata=metadata)


def check_settings(settings: Any) -> None:
    """Raise `ParameterError` where a value lies outside its declared range; call it in `__post_init__`."""
    for f in dataclasses.fields(settings):
        value, meta = getattr(settings, f.name), f.metadata
        name = f"{type(settings).__name__}.{f.name}"
        if value is None or not meta:
            continue
        if meta["choices"] and value not in meta["choices"]:
            raise ParameterError(f"{name} = {value!r}: allowed are {', '.join(meta['choices'])}")
        low, high = meta["low"], meta["high"]
        if (low is not None and value < low) or (high is not None and value > high):
            raise ParameterError(f"{name} = {value!r} {meta['unit']}: allowed is {low} to {high}")
