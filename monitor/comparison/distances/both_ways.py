"""Two surfaces measured against each other, less the vertices of which nothing sure can be said.

In: both surfaces, and the motion that brings the compared one onto the reference. Out: their sides, in that frame.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from monitor.boxes import middle_of
from monitor.comparison.distances.lone_feet import drop_lone
from monitor.comparison.distances.shell import Shell, make_shell
from monitor.comparison.distances.side import Side, drop_contradicted, larger_of, map_sides, measure_side, move_surface
from projects.model import Z95, Floats, NotAssessed, Registration, Surface


def make_shells(reference: Surface, compared: Surface, limits: tuple[float, float],
                T_reference_compared: Floats | None = None) -> tuple[Shell, Shell]:  # fmt: skip
    """Return both surfaces made ready, in coordinates about the middle of the reference; the compared one moved, where
    a motion is given. `limits` are the search limit [m] and the largest angle [rad] between normals."""
    shift = middle_of(reference.vertices)

    def make(k: int) -> Shell:
        """Return surface k (0: the reference) made ready."""
        if k == 0:
            return make_shell(reference, shift, limits)
        T = T_reference_compared
        return make_shell(compared if T is None else move_surface(compared, T), shift, limits)

    return map_sides(make, max(len(reference.vertices), len(compared.vertices)))


def measure_sides(shells: tuple[Shell, Shell], registration: Registration, left: Registration | None = None,
                  ) -> tuple[Side, Side]:  # fmt: skip
    """Return the sides (reference, compared), measured against each other, with what the registration held stable;
    `left` is the motion that stays in the distances."""
    sides = (measure_side(shells[0], shells[1], -1.0, registration, left),
             measure_side(shells[1], shells[0], 1.0, registration, left))  # fmt: skip
    on_reference, on_compared = map_sides(lambda k: drop_lone(drop_contradicted(sides[k], sides[1 - k])),
                                          larger_of(sides))  # fmt: skip
    if registration.is_stable is None or len(registration.is_stable) != len(on_compared.areas):
        return on_reference, on_compared
    seen = on_reference.is_assessed & registration.is_stable[on_reference.foot_vertices]
    return (dataclasses.replace(on_reference, is_stable=seen),
            dataclasses.replace(on_compared, is_stable=registration.is_stable))  # fmt: skip


def leave_out(sides: tuple[Side, Side], largest: float, most_stray: float) -> tuple[Side, Side]:
    """Return the sides without the vertices of which nothing sure can be said; see the functions below."""
    shares = [side.surface.stray_share for side in sides]
    return map_sides(
        lambda k: drop_scattered(drop_uncertain(sides[k], largest), shares[k], shares[1 - k], most_stray),
        larger_of(sides),
    )


def drop_uncertain(side: Side, largest: float) -> Side:
    """Return the side without the vertices whose level of detection exceeds `largest` [m] before any floor."""
    sigma = np.hypot(side.sigma_surfaces, side.sigma_common)
    too_uncertain = side.is_assessed & ~(Z95 * sigma <= largest)
    return side.without(too_uncertain, NotAssessed.TOO_UNCERTAIN)


def drop_scattered(side: Side, own: Floats | None, other: Floats | None, most: float) -> Side:
    """Return the side without the vertices where the points of both epochs lie on no one surface.

    `own` (n,) and `other` are the shares of what was measured around the vertices of either surface that lie off it,
    `most` is the largest that is assessed, in the mean of both: what is clear in one epoch and rough in the other has
    changed. Where an epoch does not know its shares nothing is left out.
    """
    if own is None or other is None:
        return side
    scattered = side.is_assessed & (own + other[side.foot_vertices] > 2.0 * most)
    return side.without(scattered, NotAssessed.NO_ONE_SURFACE)
