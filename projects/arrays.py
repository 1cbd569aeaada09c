"""The arrays that nouns hold: their kinds, and the one check of shape and values at the boundary."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from projects.errors import ParameterError, ShapeError

Floats = NDArray[np.floating[Any]]
Ints = NDArray[np.integer[Any]]
Bools = NDArray[np.bool_]
REQUIRED = ("points", "vertices", "faces")  # never None


def hold_array(noun: Any, name: str, shape: tuple[int | None, ...], kind: Any) -> None:
    """Have a frozen noun hold what it was given as `name` as an array; see `as_array`. For its `__post_init__`."""
    object.__setattr__(noun, name, as_array(getattr(noun, name), name, shape, kind))


def require_sigmas(noun: Any, *names: str) -> None:
    """Raise `ParameterError` where a noun holds standard deviations below 0 under one of the names."""
    for name in names:
        values = getattr(noun, name)
        if values is not None and (values < 0.0).any():
            lowest = float(np.nanmin(values))
            raise ParameterError(f"{name} holds {lowest:.4g} m; a standard deviation is 0 or more, NaN where unknown")


def as_array(value: ArrayLike | None, name: str, shape: tuple[int | None, ...], kind: Any) -> Any:
    """Return `value` as an array of `shape` (None: any length) and dtype `kind`, or raise `ShapeError`."""
    if value is None and name in REQUIRED:
        raise ShapeError(f"{name} is None; an array is needed")
    if value is None:
        return None
    array = numbers_of(value, name, np.dtype(kind))
    fits = array.ndim == len(shape) and all(want in (None, have) for want, have in zip(shape, array.shape, strict=True))
    if not fits:
        wanted = "(" + ", ".join("n" if s is None else str(s) for s in shape) + ")"
        raise ShapeError(f"{name} has shape {array.shape}; {wanted} is needed")
    return array


def numbers_of(value: ArrayLike, name: str, kind: np.dtype[Any]) -> Any:
    """Return `value` as an array of `kind`; raise `ShapeError` where it is no numbers or would not be the same ones."""
    if np.ma.is_masked(value):
        n = int(np.ma.count_masked(value))
        raise ShapeError(f"{name} is masked in {n} places; fill unknown values with NaN, or leave their rows out")
    try:
        given = np.asarray(value)
        if given.dtype.kind not in "biuf" and given.size:
            raise TypeError
        if kind.kind in "iu" and given.dtype != kind and given.size:
            limits = np.iinfo(kind)
            is_whole = given.dtype.kind != "f" or bool((given == np.floor(given)).all())
            if not is_whole or given.min() < limits.min or given.max() > limits.max:
                raise ShapeError(f"{name} holds other than whole numbers from {limits.min} to {limits.max}")
        return np.asarray(given, dtype=kind)
    except (TypeError, ValueError, OverflowError) as error:
        raise ShapeError(f"{name} is not an array of numbers") from error
