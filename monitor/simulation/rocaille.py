"""Rocaille as relief: C- and S-scrolls with ruffled backs, shells, lattice, drawn as heights over a face (u, v).

A `Sheet` holds heights [m] on a table; what is drawn on it is joined by the larger height, as modelled clay is laid on.
"""

from __future__ import annotations

from typing import Self

import numpy as np
from scipy.spatial import cKDTree

from monitor.simulation.shapes import Drawing, smoothstep
from projects.model import Floats


def draw_scroll(start: Floats, end: Floats, *, bulge: float, s_shaped: bool) -> Floats:
    """Return a scroll as a polyline (n, 2) between the eyes of its two volutes.

    Its curvature grows from the middle towards both ends, where it winds up by three quarters of a turn; a C bends to
    one side (`bulge` > 0: to the left of the way from start to end), an S to both.
    """
    t = np.linspace(-1.0, 1.0, 161)
    bend = 0.8 + 2.0 * np.pi * 0.75 * 7.0 * np.abs(t) ** 6
    turn = np.cumsum(bend * (np.sign(t) if s_shaped else 1.0)) * (t[1] - t[0])
    turn = -np.sign(bulge) * (turn - turn[len(t) // 2])
    speed = 1.0 - 0.85 * np.abs(t) ** 4  # the windings become narrower
    way = np.cumsum(np.column_stack([np.cos(turn), np.sin(turn)]) * speed[:, None], axis=0)
    here, there = way[-1] - way[0], np.asarray(end, dtype=float) - start
    scale = np.linalg.norm(there) / np.linalg.norm(here)
    angle = np.arctan2(there[1], there[0]) - np.arctan2(here[1], here[0])
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(start) + scale * (way - way[0]) @ np.array([[c, s], [-s, c]])


class Sheet:
    """A table of heights [m] over (u, v) [m], drawn on step by step and handed over as a `Drawing`."""

    def __init__(self, low: tuple[float, float], high: tuple[float, float], step: float = 0.0015) -> None:
        self._low, self._step = np.array(low), step
        self._u, self._v = (np.arange(a, b, step) for a, b in zip(low, high, strict=True))
        self._heights = np.zeros((len(self._u), len(self._v)))

    def heights(self) -> Drawing:
        """Return what was drawn."""
        return Drawing(self._heights.copy(), self._low, self._step)

    def _window(self, low: Floats, high: Floats) -> tuple[slice, slice, Floats, Floats]:
        """Return which nodes lie in a box, as two slices, and their places (u, v)."""
        i0, j0 = np.maximum(((low - self._low) / self._step).astype(int), 0)
        i1, j1 = np.maximum(((high - self._low) / self._step).astype(int) + 2, 0)
        u, v = np.meshgrid(self._u[i0:i1], self._v[j0:j1], indexing="ij")
        return slice(i0, i0 + u.shape[0]), slice(j0, j0 + u.shape[1]), u, v

    def _lay(self, i: slice, j: slice, height: Floats) -> Self:
        """Raise the nodes to `height` where they lie lower."""
        self._heights[i, j] = np.maximum(self._heights[i, j], height)
        return self

    def scroll(self, line: Floats, *, width: float, height: float, ruffle: float = 0.0, both: bool = False) -> Self:
        """Draw a scroll along a polyline: a grooved band that tapers into its volutes, eyes at their ends, and on its
        outer side (with `both` on both) a ruffled comb that reaches `ruffle` [m] beyond it."""
        reach = width + ruffle
        i, j, u, v = self._window(line.min(axis=0) - reach, line.max(axis=0) + reach)
        gap, run, side = _nearest_on_line(line, u, v)
        length = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
        share = run / length
        taper = 0.35 + 0.65 * np.sin(np.pi * np.clip(share, 0.0, 1.0)) ** 0.6
        s = gap / (width * taper)
        band = np.sqrt(np.maximum(1.0 - s * s, 0.0)) * (0.78 + 0.22 * np.cos(2.0 * np.pi * s))
        drawn = height * (0.55 + 0.45 * taper) * band
        for eye in (line[0], line[-1]):
            drawn = np.maximum(drawn, 1.15 * np.sqrt(np.maximum(width**2 - (u - eye[0]) ** 2 - (v - eye[1]) ** 2, 0.0)))
        if ruffle > 0.0:
            waves = np.abs(np.sin(np.pi * run / (0.7 * width)))
            comb_reach = ruffle * taper * (0.7 + 0.3 * waves)
            comb = smoothstep(comb_reach - (gap - 0.8 * width * taper), 0.0, 0.35 * ruffle) * (gap > 0.3 * width)
            comb = comb * (0.45 + 0.35 * waves) * smoothstep(np.sin(np.pi * share), 0.15, 0.6)
            outer = np.ones_like(side) if both else (side * np.sign(_signed_area(line)) < 0.0)
            drawn = np.maximum(drawn, height * comb * outer)
        return self._lay(i, j, drawn)

    def shell(
        self, at: tuple[float, float], *, radius: float, height: float, lobes: int = 9, spread: float = 200.0,
        turn: float = 90.0,
    ) -> Self:  # fmt: skip
        """Draw a scallop shell: `lobes` flutes from `at`, opening by `spread` degrees about the direction `turn`."""
        i, j, u, v = self._window(np.array(at) - 1.1 * radius, np.array(at) + 1.1 * radius)
        r, angle = np.hypot(u - at[0], v - at[1]), np.degrees(np.arctan2(v - at[1], u - at[0]))
        away = ((angle - turn + 180.0) % 360.0 - 180.0) / spread  # -0.5 to 0.5 across the shell
        flute = np.sqrt(np.abs(np.cos(np.pi * lobes * away)) + 0.01)
        rim = radius * (0.86 + 0.14 * flute) * np.cos(np.pi * np.clip(away, -0.5, 0.5)) ** 0.25
        inside = smoothstep(rim - r, 0.0, 0.12 * radius) * (np.abs(away) < 0.5)
        rise = np.sin(0.5 * np.pi * np.clip(0.25 + 0.75 * r / radius, 0.0, 1.0))
        drawn = height * inside * rise * (0.5 + 0.5 * flute)
        boss = 0.9 * height * np.sqrt(np.maximum(1.0 - (r / (0.2 * radius)) ** 2, 0.0))
        return self._lay(i, j, np.maximum(drawn, boss))

    def lattice(self, low: tuple[float, float], high: tuple[float, float], *, mesh: float, height: float) -> Self:
        """Draw a trellis of crossing bars with a pearl in each opening, inside an oval between two corners."""
        i, j, u, v = self._window(np.array(low), np.array(high))
        middle, half = 0.5 * (np.array(low) + high), 0.5 * (np.array(high) - low)
        a, b = ((u - middle[0]) + (v - middle[1])) / mesh, ((u - middle[0]) - (v - middle[1])) / mesh
        to_bar = mesh * np.minimum(np.abs(a - np.round(a)), np.abs(b - np.round(b))) / np.sqrt(2.0)
        bars = 1.0 - smoothstep(to_bar, 0.05 * mesh, 0.14 * mesh)
        pearl = mesh * np.hypot(a - np.floor(a) - 0.5, b - np.floor(b) - 0.5) / np.sqrt(2.0)
        pearls = np.sqrt(np.maximum(1.0 - (pearl / (0.13 * mesh)) ** 2, 0.0))
        oval = ((u - middle[0]) / half[0]) ** 4 + ((v - middle[1]) / half[1]) ** 4
        return self._lay(i, j, height * np.maximum(bars, 0.9 * pearls) * (1.0 - smoothstep(oval, 0.75, 1.0)))

    def mirrored_scroll(
        self, start: tuple[float, float], end: tuple[float, float], *, width: float, height: float,
        ruffle: float = 0.0, bulge: float = 1.0, s_shaped: bool = False,
    ) -> Self:  # fmt: skip
        """Draw a scroll and its mirror image about u = 0."""
        line = draw_scroll(np.array(start), np.array(end), bulge=bulge, s_shaped=s_shaped)
        self.scroll(line, width=width, height=height, ruffle=ruffle)
        return self.scroll(line * [-1.0, 1.0], width=width, height=height, ruffle=ruffle)


def _nearest_on_line(line: Floats, u: Floats, v: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the distance to a polyline, the way along it to the nearest place, and the side (left positive)."""
    at = np.linspace(0.0, len(line) - 1.0, 12 * len(line))
    dense = np.column_stack([np.interp(at, np.arange(len(line)), line[:, k]) for k in (0, 1)])
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(dense, axis=0), axis=1))])
    gap, k = cKDTree(dense).query(np.column_stack([u.ravel(), v.ravel()]))
    along = np.gradient(dense, axis=0)[k]
    side = np.sign(along[:, 0] * (v.ravel() - dense[k, 1]) - along[:, 1] * (u.ravel() - dense[k, 0]))
    return gap.reshape(u.shape), way[k].reshape(u.shape), side.reshape(u.shape)


def _signed_area(line: Floats) -> float:
    """Return twice the area that a polyline encloses with its chord, positive counter-clockwise."""
    following = np.roll(line, -1, axis=0)
    return float((line[:, 0] * following[:, 1] - line[:, 1] * following[:, 0]).sum())
