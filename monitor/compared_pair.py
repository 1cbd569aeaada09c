"""Two epochs of an object against each other: registered, compared, and which parts moved (steps 11 to 13).

In: the places of both epochs, the steps that made their surfaces, and settings. Out: what a comparison's step keeps.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

from monitor.comparison import compare
from monitor.comparison.regions.as_given import doubt_as_given
from monitor.comparison.regions.beside_parts import tell_apart
from monitor.comparison.regions.moved_parts import doubt_which_stood, tell_moved
from monitor.held_placement import place_against_held
from monitor.measured import filtered, measured_points
from monitor.record import Made, Place
from monitor.registration.epochs import held_by_frames, register_epochs
from monitor.registration.motion.held import Frames
from monitor.registration.parts import find_parts
from monitor.scan_network import frames_of
from monitor.second_opinion import ask_m3c2
from monitor.settings import Settings
from monitor.sights import gather_sights
from projects.extent import Extent, inside, require_part
from projects.model import Z95, Comparison, Registration, Step, Surface


class Pair(NamedTuple):
    """An earlier and a later epoch, and the steps that made their surfaces."""

    earlier: Place
    later: Place
    before: Step
    after: Step


class Registered(NamedTuple):
    """The surfaces of both epochs, the motion of the later onto the earlier, what it started from in words and figures,
    and what ties the epochs together where control does."""

    surfaces: tuple[Surface, Surface]
    motion: Registration
    start: Mapping[str, Any]
    tied: Frames | None


def register_pair(pair: Pair, settings: Settings, mode: str, stable: Extent | None) -> Registered:
    """Register the later epoch to the earlier (step 11). In relative mode the surfaces state what their neighbourhoods
    share in error about what holds the motion."""
    reference, compared = pair.earlier.get(pair.before), pair.later.get(pair.after)
    if stable is not None:
        require_part(stable, reference.vertices, compared.vertices)
    tied = frames_of((pair.earlier, pair.later))
    within = None if stable is None else partial(inside, stable)
    motion, start = register_epochs(compared, reference, settings.icp, tied, within)
    if mode == "absolute" and tied is not None and not motion.converged:
        motion = held_by_frames(tied, motion)
    if mode == "relative":
        reference, compared = place_against_held((pair.earlier, pair.later), (reference, compared), motion)
    return Registered((reference, compared), motion, start, tied)


def compare_registered(pair: Pair, registered: Registered, settings: Settings, mode: str, tolerance: float | None,
                        *, stable_is_given: bool) -> Comparison:  # fmt: skip
    """Compare registered epochs (step 12) and tell which parts moved (step 13)."""
    (reference, compared), motion, _, tied = registered
    sights = gather_sights(pair.earlier), gather_sights(pair.later)
    frames = tied.about(motion.centre) if tied is not None else None
    ask = partial(compare, reference, compared, motion, settings.compare, mode, tolerance, sights, frames=frames,
                  points=lambda: (measured_points(pair.earlier), measured_points(pair.later)),
                  stable_is_given=stable_is_given)  # fmt: skip
    found = ask()
    if not len(found.regions):
        return found
    side = found.on_compared  # what moved as a whole shows as regions of change
    parts = find_parts(compared, reference, motion, settings.parts, side.is_changed, side.lod95 / Z95)
    if mode == "relative":  # else the motion of the whole is in the differences beside the parts, too
        found = tell_apart(found, parts, compared.vertices, lambda apart: ask(apart=apart))
    found = tell_moved(found, parts, compared.vertices)
    if mode == "relative" and not stable_is_given and tied is None and not motion.stable_is_rest:
        found = doubt_as_given(doubt_which_stood(found))
    return found


def with_second_opinion(pair: Pair, found: Comparison, start: Mapping[str, Any]) -> Made:
    """Return a comparison with what M3C2 says of the same epochs, where both have points."""
    clouds = filtered(pair.earlier), filtered(pair.later)
    if clouds[0] is None or clouds[1] is None:
        return Made(found, start)
    return Made(found, {**start, "m3c2": ask_m3c2(found, clouds[0], clouds[1])})
