"""What an experiment hands back: rows of a table, and the figures of several seeds in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

Verdict = Literal["pass", "not yet", "stated"]
Size = Literal["small", "full"]
SIZES: tuple[Size, ...] = ("small", "full")


@dataclass(frozen=True)
class Row:
    """One line of an experiment's table.

    Attributes
    ----------
    what : the quantity and the case.
    ours : our figure, with its unit unless the table's title gives it.
    verdict : "pass" or "not yet" where a bar is asked for, "stated" where a figure is only told.
    paper, asked : the paper's figure and the bar, in words.
    others : further columns, heading to text: peers run on the same input, other definitions of the quantity.
    value : our figure as a number, for those who follow it through time.
    cause : why a bar is not reached, a sentence for the notes below the table.
    """

    what: str
    ours: str
    verdict: Verdict = "stated"
    paper: str = ""
    asked: str = ""
    others: Mapping[str, str] = field(default_factory=dict)
    value: float = float("nan")
    cause: str = ""


def judge(holds: bool) -> Verdict:
    """Return the verdict of a bar that holds or not; what is not a number holds nothing."""
    return "pass" if holds else "not yet"


def mean_of(values: Sequence[float]) -> tuple[float, float]:
    """Return the mean of a figure over seeds and its standard error, NaN of a single seed."""
    known = np.asarray(values, float)
    error = float(known.std(ddof=1) / np.sqrt(len(known))) if len(known) > 1 else float("nan")
    return float(known.mean()), error


def in_words(value: float, digits: int = 3, unit: str = "", signed: bool = False) -> str:
    """Return a figure with a minus that prints well, "-" where it is not known."""
    if not np.isfinite(value):
        return "-"
    value = round(value, digits) + 0.0
    text = f"{value:+.{digits}f}" if signed and value else f"{value:.{digits}f}"
    return text.replace("-", "−") + (f" {unit}" if unit else "")


def in_percent(share: float, digits: int = 0) -> str:
    """Return a share in percent, "-" where it is not known."""
    return f"{share:.{digits}%}" if np.isfinite(share) else "-"


def as_mapping(row: Row) -> dict[str, Any]:
    """Return a row as plain values for JSON; what is not known is null."""
    known = {k: v for k, v in vars(row).items() if v not in ("", {})}
    known["value"] = row.value if np.isfinite(row.value) else None
    return known
