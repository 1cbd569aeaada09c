"""Roman capitals as strokes, for the inscription carved into the pedestal of the demo's figure.

Letters are drawn in a square of height 1 standing on v = 0; `write_line` sets them side by side.
"""

from __future__ import annotations

import numpy as np

from projects.errors import ParameterError
from projects.model import Floats


def _line(*points: tuple[float, float]) -> Floats:
    """Return a polyline through points (m, 2)."""
    return np.array(points, dtype=float)


def _arc(centre: tuple[float, float], radii: tuple[float, float], start: float, end: float) -> Floats:
    """Return an elliptic arc from `start` to `end` degrees, counter-clockwise from the right."""
    angle = np.radians(np.linspace(start, end, 17))
    return np.column_stack([centre[0] + radii[0] * np.cos(angle), centre[1] + radii[1] * np.sin(angle)])


def _serif(u: float, v: float, half: float = 0.09) -> Floats:
    """Return the level stroke that ends a stem at (u, v)."""
    return _line((u - half, v), (u + half, v))


_LETTERS: dict[str, tuple[float, list[Floats]]] = {
    "A": (0.80, [_line((0.02, 0), (0.40, 1)), _line((0.40, 1), (0.78, 0)), _line((0.16, 0.36), (0.64, 0.36)),
                 _serif(0.02, 0), _serif(0.78, 0)]),
    "E": (0.56, [_line((0.08, 0), (0.08, 1)), _line((0, 1), (0.5, 1), (0.5, 0.92)), _line((0.08, 0.52), (0.42, 0.52)),
                 _line((0, 0), (0.52, 0), (0.52, 0.08))]),
    "G": (0.84, [_arc((0.45, 0.5), (0.42, 0.5), 42, 318), _line((0.76, 0.16), (0.76, 0.44)), _serif(0.76, 0.44)]),
    "H": (0.80, [_line((0.1, 0), (0.1, 1)), _line((0.7, 0), (0.7, 1)), _line((0.1, 0.52), (0.7, 0.52)),
                 _serif(0.1, 0), _serif(0.7, 0), _serif(0.1, 1), _serif(0.7, 1)]),
    "I": (0.24, [_line((0.12, 0), (0.12, 1)), _serif(0.12, 0), _serif(0.12, 1)]),
    "M": (0.94, [_line((0.08, 0), (0.14, 1)), _line((0.14, 1), (0.47, 0.08)), _line((0.47, 0.08), (0.80, 1)),
                 _line((0.80, 1), (0.86, 0)), _serif(0.08, 0), _serif(0.86, 0)]),
    "N": (0.84, [_line((0.1, 0), (0.1, 1)), _line((0.1, 1), (0.74, 0)), _line((0.74, 0), (0.74, 1)), _serif(0.1, 0),
                 _serif(0.74, 1)]),
    "O": (0.92, [_arc((0.46, 0.5), (0.44, 0.5), 0, 360)]),
    "R": (0.70, [_line((0.1, 0), (0.1, 1)), _line((0.1, 1), (0.34, 1)), _arc((0.34, 0.75), (0.24, 0.25), 90, -90),
                 _line((0.34, 0.5), (0.1, 0.5)), _line((0.30, 0.5), (0.68, 0)), _serif(0.1, 0), _serif(0.66, 0, 0.06)]),
    "T": (0.68, [_line((0.34, 0), (0.34, 1)), _line((0, 0.92), (0, 1), (0.68, 1), (0.68, 0.92)), _serif(0.34, 0)]),
    "V": (0.78, [_line((0.02, 1), (0.39, 0)), _line((0.39, 0), (0.76, 1)), _serif(0.02, 1), _serif(0.76, 1)]),
    "X": (0.76, [_line((0.05, 1), (0.71, 0)), _line((0.05, 0), (0.71, 1)), _serif(0.05, 0), _serif(0.71, 0),
                 _serif(0.05, 1), _serif(0.71, 1)]),
    " ": (0.30, []),
}  # fmt: skip


def write_line(text: str, *, height: float, middle: tuple[float, float], spacing: float = 0.2) -> list[Floats]:
    """Return the strokes of a line of capitals as polylines (k, 2) [m], centred on `middle`.

    `height` [m] of the capitals; `spacing` between letters as a share of it. Raises `ParameterError` for a letter
    that was never drawn.
    """
    missing = sorted(set(text) - set(_LETTERS))
    if missing:
        raise ParameterError(f"no strokes for {' '.join(missing)}; the letters drawn are {''.join(sorted(_LETTERS))}")
    widths = [_LETTERS[letter][0] for letter in text]
    total = sum(widths) + spacing * (len(text) - 1)
    left, strokes = -0.5 * total, []
    for letter, width in zip(text, widths, strict=True):
        for stroke in _LETTERS[letter][1]:
            strokes.append(np.asarray(middle) + height * (stroke + np.array([left, -0.5])))
        left += width + spacing
    return strokes
