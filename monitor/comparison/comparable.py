"""What can be compared: two sound surfaces, near each other, of two surveys, and a motion that settled.

In come what `compare` was given; what cannot be compared is refused with what was found and what to do.
"""

from __future__ import annotations

import math
import numbers

import numpy as np

from monitor.comparison.distances.side import Side
from monitor.comparison.summary import count_reasons
from monitor.copied_faces import share_both_ways, without_copied_faces
from monitor.winding import is_inside_out, share_against
from projects.errors import ComparisonError, ParameterError, RegistrationError
from projects.model import Bools, Floats, Registration, Surface, require_noun
from projects.transforms import require_rigid

MODES = ("relative", "absolute")
MOST_BOTH_WAYS = 0.5  # of the faces: with more, vertices have no normal, and distances no sign
MOST_AGAINST = 0.1  # of the edges, as of one face in twenty: below, few vertices cannot be assessed, and no figure errs
TURN = "turn them, as monitor.winding.wind_outward(surface).surface does"
ROUNDED = 1e-6  # of a covariance, as a correlation: what rounding alone makes of its two halves
MOSTLY = 0.5  # share of the samples with a partner, from which on epochs that failed to register do lie near each other


def require_comparable(reference: Surface, compared: Surface, registration: Registration | None, mode: str,
                       tolerance: float | None, apart: tuple[Bools, Bools] | None,
                       frames: Floats | None) -> None:  # fmt: skip
    """Raise `ParameterError` or `ComparisonError` where something given to `compare` is none of what it stands for."""
    if mode not in MODES:
        raise ParameterError(f"mode {mode!r}: allowed are {' and '.join(MODES)}")
    require_sound(reference, compared)
    if registration is not None:
        require_noun(registration, "the registration", Registration)
    require_tolerance(tolerance)
    require_covariance(frames)
    require_masks(apart, (len(reference.vertices), len(compared.vertices)))


def settle_motion(reference: Surface, compared: Surface, registration: Registration | None,
                  limit: float) -> Registration:  # fmt: skip
    """Return the registration of the compared surface onto the reference, estimated where none is given.

    Raises `ComparisonError` where the surfaces lie farther apart than `limit` [m] or are one, `RegistrationError` where
    the registration did not converge.
    """
    if registration is None:
        require_near(reference, compared, limit)
    registration = require_settled(register_epochs(reference, compared) if registration is None else registration)
    require_two(reference, compared)
    return registration


def register_epochs(reference: Surface, compared: Surface) -> Registration:
    """Return the registration of the compared epoch onto the reference."""
    from monitor.registration import register

    return register(compared, reference)


def require_sound(reference: Surface, compared: Surface) -> None:
    """Raise `ComparisonError` where a surface has no faces, vertices that are not finite, or no outer side.

    A finished mesh, of which nobody says how far its samples are, may have been written inside out; one that was made
    of points looks to where they were seen from.
    """
    for surface, name in ((reference, "reference"), (compared, "compared")):
        require_noun(surface, f"the {name} surface", Surface)
        if not len(surface.faces):
            raise ComparisonError(f"the {name} surface has no faces; give a sound mesh")
        if not np.isfinite(surface.vertices).all():
            n_bad = int((~np.isfinite(surface.vertices)).any(axis=1).sum())
            raise ComparisonError(
                f"the {name} surface has {n_bad} of {len(surface.vertices)} vertices that are not finite; "
                "give a sound mesh"
            )
        share = share_both_ways(without_copied_faces(surface))
        if share > MOST_BOTH_WAYS:
            raise ComparisonError(
                f"{100.0 * share:.0f} % of the faces of the {name} surface are there in both directions, and have no "
                "outer side: what is gained or lost is not known; leave out the inner one of each two"
            )
        share = share_against(surface)
        if share > MOST_AGAINST:
            raise ComparisonError(
                f"along {100.0 * share:.0f} % of the edges of the {name} surface its faces look opposite ways: its "
                f"outer side, and what is gained or lost there, is not known; {TURN}"
            )
        if surface.sample_distance is None and is_inside_out(surface):
            raise ComparisonError(
                f"the {name} surface is inside out: its faces look into the body that they enclose, and what was lost "
                f"would be told as added; {TURN}"
            )


def require_masks(apart: tuple[Bools, Bools] | None, sizes: tuple[int, int]) -> None:
    """Raise `ParameterError` where `apart` is given and is no pair of masks of as many vertices as `sizes` says."""
    if apart is None:
        return
    given = list(apart) if isinstance(apart, tuple | list) else [apart]
    kinds = [f"{w.dtype} {w.shape}" if isinstance(w, np.ndarray) else type(w).__name__ for w in given]
    if kinds != [f"bool {(n,)}" for n in sizes]:
        raise ParameterError(
            f"apart is {' and '.join(kinds)}: give one mask of bool for each surface's vertices, {(sizes[0],)} and "
            f"{(sizes[1],)}"
        )


def require_given_areas(registration: Registration | None, n_vertices: int) -> None:
    """Raise `ParameterError` where the stable areas that someone gave are not told of the compared surface's vertices.

    Without them all would be judged as if nobody knew where nothing changed.
    """
    is_stable = None if registration is None else registration.is_stable
    if registration is None or (is_stable is not None and len(is_stable) != n_vertices):
        told = "no registration is given" if is_stable is None else f"the registration's is_stable has {len(is_stable)}"
        raise ParameterError(
            f"stable_is_given, but {told}: give the registration of the compared surface within these areas, whose "
            f"is_stable has a value for each of its {n_vertices} vertices"
        )


def require_covariance(given: Floats | None, what: str = "frames") -> None:
    """Raise `ParameterError` where what is given, of a motion or of how far frames may differ, is no covariance.

    Of one that is not symmetric each formula would read another half.
    """
    if given is None:
        return
    try:
        values = np.asarray(given)
    except ValueError:  # rows of different lengths
        values = np.empty(0)
    is_one = values.shape == (6, 6) and values.dtype.kind in "iuf" and bool(np.isfinite(values).all())
    if not is_one or np.linalg.eigvalsh(values).min() < -1e-9 * np.abs(values).max():
        raise ParameterError(
            f"{what} has shape {values.shape}: a covariance (6, 6) of rotation [rad] and shift [m] is needed, finite "
            "and without negative variances"
        )
    sigmas = np.sqrt(np.maximum(np.diag(values), 0.0))
    apart = np.abs(values - values.T) > ROUNDED * np.outer(sigmas, sigmas)
    if apart.any():
        i, j = np.argwhere(apart)[0]
        raise ParameterError(
            f"{what} is not symmetric: {values[i, j]:.6g} in row {i + 1}, column {j + 1} and {values[j, i]:.6g} in row "
            f"{j + 1}, column {i + 1}; a covariance (6, 6) of rotation [rad] and shift [m] is needed"
        )


def require_tolerance(tolerance: float | None) -> None:
    """Raise `ParameterError` where a client's tolerance is no length."""
    if tolerance is None:
        return
    is_number = isinstance(tolerance, numbers.Real) and not isinstance(tolerance, bool)
    if not is_number or not 0.0 < tolerance < math.inf:
        raise ParameterError(f"tolerance {tolerance!r}: a length above 0 m is needed, or None")


def require_two(reference: Surface, compared: Surface) -> None:
    """Raise `ComparisonError` where both surfaces are one, and nothing is stated of its errors.

    Errors that are the same in both show no error at all.
    """
    if reference.sigma is not None and compared.sigma is not None:
        return
    if np.array_equal(reference.vertices, compared.vertices) and np.array_equal(reference.faces, compared.faces):
        raise ComparisonError(
            "the compared surface is the reference itself, vertex by vertex, and states no sigma: what was measured "
            "once can show no change, and its level of detection is not known; give the surfaces of two surveys"
        )


def require_near(reference: Surface, compared: Surface, limit: float) -> None:
    """Raise `ComparisonError` where the boxes of the surfaces lie farther apart than `limit` [m]."""
    low = np.maximum(reference.vertices.min(axis=0), compared.vertices.min(axis=0))
    high = np.minimum(reference.vertices.max(axis=0), compared.vertices.max(axis=0))
    gap = float(np.linalg.norm(np.maximum(low - high, 0.0)))
    if gap > limit:
        raise ComparisonError(f"the epochs do not overlap: they lie {gap:.4g} m apart; check their poses and units")


def require_settled(registration: Registration) -> Registration:
    """Return the registration, a rigid one; raise `RegistrationError` with its reason where it did not converge."""
    if not registration.converged:
        overlaps = registration.overlap > MOSTLY  # what is seen to overlap is not asked for
        asked = "" if overlaps else "; do they overlap? check their poses and units"
        reason = registration.reason or "it did not converge"
        raise RegistrationError(f"the epochs could not be registered: {reason}{asked}")
    require_rigid(registration.T_target_source, "the registration")
    require_covariance(registration.covariance, "the registration's covariance")
    if not np.isfinite(registration.centre).all():
        raise ParameterError(f"the registration's centre {registration.centre}: three finite coordinates are needed")
    return registration


def require_common(sides: tuple[Side, Side], limit: float) -> None:
    """Raise `ComparisonError` where no vertex of either side (reference, compared) can be assessed."""
    if not any(s.is_assessed.any() for s in sides):
        counts = count_reasons(sides[1].reasons)
        reasons = ", ".join(f"{name} {n}" for name, n in counts.items() if n)
        if counts["no_one_surface"] == max(counts.values()):
            raise ComparisonError(
                f"nothing of the compared epoch can be assessed ({reasons}): most of what was measured lies off the "
                "surfaces, as of plants; a larger compare.max_stray_share assesses it all the same"
            )
        why = "the epochs do not overlap, or not the same side of them: check their poses and units"
        if counts["free_edge"] == max(counts.values()):
            why = (
                "surfaces end there: faces join only where they share vertices, so merge those at one place, as of an "
                "STL; else the epochs overlap by no more than their borders"
            )
        elif counts["too_uncertain"] == max(counts.values()):
            why = "what is stated of their errors or those of the motion, or a limit of the settings, leaves no level"
        raise ComparisonError(
            f"nothing of the compared epoch can be assessed within {limit:.4g} m of the reference ({reasons}); {why}"
        )
