"""Is every motion held by the shape? A plane slides, a sphere or a vase turns: the registration cannot know.

In: the pairs of the stable areas at the solution. Out: the free motion in plain words, or nothing.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import binom

from monitor.registration.motion.covariance import shape_information
from monitor.registration.motion.held import FreeMotions
from monitor.registration.motion.matching import Matches
from monitor.registration.motion.sampling import lever_of, motion_rows
from projects.model import Floats, Ints

N_SIGMAS = 4.0  # the information on every motion must exceed its own uncertainty so many times
SAYS_AT_MOST = 0.99  # quantile of what patches say of a motion: none says more
BY_CHANCE = 3e-5  # p value of so many patches that hold a motion, where noise alone does in one of two
NOISE_SHARE = 0.05  # and be no less than this share of what relief and noise of the normals seem to give together


def find_free_motions(matches: Matches, centre: Floats, patch: Ints, by_sign: bool = False) -> FreeMotions | None:
    """Return the motions that the shape does not hold, None where all six are held.

    The information of the shape is estimated without the noise of the normals (`shape_information`); its weakest
    directions must differ from zero under the scatter between patches, the largest of which count as others do
    (`cap_largest`). `by_sign`, for parts of few patches, which err independently: or by the sign of most. Few that all
    hold a motion, some much more than others, scatter as widely as they hold.
    """
    lever = max(lever_of(matches.points, centre), 1e-300)
    scale = np.repeat([1.0 / lever, 1.0], 3)
    ones = np.full(len(matches), 1.0 / len(matches))
    shape = shape_information(matches, centre, ones) * np.outer(scale, scale)
    values, vectors = np.linalg.eigh(shape)
    _, member = np.unique(patch, return_inverse=True)
    free = []
    for value, vector in zip(values, vectors.T, strict=True):
        a = motion_rows(matches.points, matches.normals_source, centre) @ (scale * vector)
        b = motion_rows(matches.points, matches.normals_target, centre) @ (scale * vector)
        sums = np.bincount(member, a * b) / len(matches)
        capped = cap_largest(sums)
        apparent = float(np.mean(0.5 * (a**2 + b**2)))
        is_shape = np.sum(capped) > N_SIGMAS * np.sqrt(np.sum(capped**2))
        if by_sign and not is_shape:
            is_shape = binom.sf(np.sum(sums > 0.0) - 1, len(sums), 0.5) < BY_CHANCE
        if is_shape and value > NOISE_SHARE * apparent:
            break
        free.append(scale * vector)
    if not free:
        return None
    directions = np.stack(free, axis=1)
    return FreeMotions(directions, centre, lever, say_free(directions, lever))


def say_free(motions: Floats, lever: float) -> str:
    """Return free motions (6, k) [rad, m] in words: with as few turns as all mixtures of them allow.

    A plate slides along two directions and turns about its normal. Any three mixtures of these are as free, and may
    each look like a slide: three slides in one plane.
    """
    scaled = motions / np.repeat([1.0 / lever, 1.0], 3)[:, None]
    _, _, mixing = np.linalg.svd(scaled[:3], full_matrices=True)
    return " and ".join(describe(m, lever) for m in (motions @ mixing.T).T[::-1])


def cap_largest(sums: Floats) -> Floats:
    """Return what each patch says (n,) with no more said by any than by all but one in a hundred.

    One patch of a rib that holds a turn as much as half of the others together says no less for what these say.
    """
    most = float(np.quantile(np.abs(sums), SAYS_AT_MOST))
    return np.clip(sums, -most, most)


def find_free_motion(matches: Matches, centre: Floats, patch: Ints, by_sign: bool = False) -> str:
    """Return in words the motions that the shape does not hold and what would, or an empty text where all are held."""
    free = find_free_motions(matches, centre, patch, by_sign)
    if free is None:
        return ""
    return (
        f"the shape does not hold it: it can {free.words} without being noticed; control points in both epochs would "
        "hold it, or a wider extent with more shape"
    )


def describe(motion: Floats, lever: float) -> str:
    """Return a motion (6,) [rad, m] in words: a turn about an axis or a slide along a direction."""
    w, t = motion[:3] * lever, motion[3:]
    turns = np.linalg.norm(w) > np.linalg.norm(t)
    axis = w if turns else t
    axis = axis / (np.linalg.norm(axis) * np.sign(axis[np.abs(axis).argmax()]))  # an axis has no sense: one is chosen
    x, y, z = np.round(axis, 2) + 0.0
    return f"{'turn about the axis' if turns else 'slide along'} ({x:.2f}, {y:.2f}, {z:.2f})"
