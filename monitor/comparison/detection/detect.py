"""Which vertices have changed: false discoveries held over the whole surface, not vertex by vertex.

In: the two measured sides. Out: the noise learned from what is stable, and for each side lod95, the smoothed change
and whether each vertex is changed. Two passes: the first finds what stands out of the core of all distances; the
second learns from all the rest, stable by registration or not, since areas chosen for their small residuals show too
little noise. What is suspect, significant or not, does not teach: a change not found yet would raise its own floor.
Where in the end nothing is significant, what was suspect is the tail of the errors: the level is learned from all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from monitor.comparison.detection.marking import find_deep, level_at, mark_changed
from monitor.comparison.detection.patches import (
    Layout,
    Patches,
    benjamini_hochberg,
    lay_out_again,
    lay_out_patches,
    lay_out_without,
    measure_patches,
)
from monitor.comparison.detection.reaches import least_of_patches
from monitor.comparison.detection.rest import away_from_both, away_from_suspect, can_teach, suspect_alone
from monitor.comparison.detection.tested import Detected, Tested
from monitor.comparison.detection.units import Units, judge_noise, unit_size
from monitor.comparison.distances.side import Side, larger_of, map_sides
from monitor.comparison.noise.level_of_detection import far_levels
from monitor.comparison.noise.model import Masks, Noise, learn_noise
from monitor.comparison.noise.patch_errors import PatchErrors, calm_errors, first_errors, tailed_errors
from monitor.comparison.noise.scan_errors import AS_STATED, ScanErrors, learn_scans
from monitor.threads import map_threads
from projects.model import Bools, Floats, Ints, Registration

Both = tuple[Patches, Patches]  # of the reference and the compared side
LearnErrors = Callable[[Floats, Ints], PatchErrors]

BESIDE = 3.0  # sigmas: what lies within them belongs to the rest
N_ROUNDS = 2  # of learning from what the last test left unchanged
CORE_SHARE = 0.6827  # of the vertices that the first pass looks at: up to a third may have changed


def detect(sides: tuple[Side, Side], registration: Registration, level: float, seed: int,
           left: Registration | None = None, is_given: bool = False, is_rest: bool = False,
           plain: Masks | None = None) -> Detected:  # fmt: skip
    """Decide for both sides which vertices have changed, with a false discovery rate of `level` over the surface.

    `left` is the motion of the whole that stays in the distances. It is change and no error: the noise is learned
    without it, and all is judged by that. `is_given`: someone knows that what is stable did not change; then it alone
    tells the noise, be it ever so small a part; so it does where the stable areas are what a layer on most of the
    object left out (`is_rest`). Where nothing of it is stable, as if nobody knew. What changed plainly (`plain`, of
    both sides) does not teach, unless nothing is significant in the end.
    """
    is_known = (is_given or is_rest) and any((s.is_stable & s.is_assessed).any() for s in sides)
    learn = partial(learn_from_given, is_sharp=is_given) if is_known else partial(learn_and_judge, plain=plain)
    if left is None:
        return learn(sides, registration, level, seed)
    own = (sides[0].without_motion(), sides[1].without_motion())
    by_itself = learn(own, left, level, seed)
    noise, calm = by_itself.noise, by_itself.calm
    layout = lay_out_again(by_itself.layout, sides, registration)
    test = judge_units(layout, sides, calm, noise, level, lambda _: by_itself.test.errors, by_itself.test.scans)
    return conclude(sides, noise, test, layout, calm, registration, own)


def learn_and_judge(sides: tuple[Side, Side], registration: Registration, level: float, seed: int,
                    plain: Masks | None = None) -> Detected:  # fmt: skip
    """Learn the noise from what is stable, then from all that did not change, and judge by it; what is `plain` change
    does not teach, unless nothing is significant in the end."""
    rng = np.random.default_rng(seed)
    calm = without_plain((stable_or_all(sides[0]), stable_or_all(sides[1])), plain)
    noise = learn_noise(sides, calm, CORE_SHARE, rng)
    layout = lay_out(sides, noise, registration, None)
    test = judge_units(layout, sides, calm, noise, level, partial(learn_errors, first_errors), AS_STATED)
    teaches_all = False
    for _ in range(N_ROUNDS):
        rest, sure = find_rest(sides, test, layout, noise, calm, registration, plain)
        if rest is not None:
            calm, noise = rest, learn_noise(sides, rest, 0.95, rng, noise.correlation)
            layout = lay_out(sides, noise, registration, layout)
            test = judge_beside(sure, layout, sides, calm, noise, level, registration)
            teaches_all = test.limit == 0.0
    if teaches_all:  # nothing has changed: what was suspect is the tail of the errors, and the level must know it
        calm = (sides[0].is_assessed, sides[1].is_assessed)
        noise = learn_noise(sides, calm, 0.95, rng, noise.correlation)
    return conclude(sides, noise, test, layout, calm, registration)


def learn_from_given(sides: tuple[Side, Side], registration: Registration, level: float, seed: int,
                     is_sharp: bool = True) -> Detected:  # fmt: skip
    """Learn the noise from what is stable alone, and judge by it: all the rest may have changed.

    Stable areas that nobody drew (`is_sharp` False) are made of patches, some of which reach into what changed: of them
    only what lies away from all that stands out of their core teaches.
    """
    rng = np.random.default_rng(seed)
    calm = (stable_or_all(sides[0]), stable_or_all(sides[1]))
    first = learn_noise(sides, calm, 0.95 if is_sharp else CORE_SHARE, rng)
    if not is_sharp:
        layout = lay_out(sides, first, registration, None)
        test = judge_units(layout, sides, calm, first, level, partial(learn_errors, first_errors), AS_STATED)
        rest = away_from_both(sides, test)
        inner = (calm[0] & rest[0], calm[1] & rest[1])
        calm = inner if inner[0].any() and inner[1].any() else calm
        first = learn_noise(sides, calm, 0.95, rng)
    noise = learn_noise(sides, calm, 0.95, rng, first.correlation)
    layout = lay_out(sides, noise, registration, None)
    test = judge_units(layout, sides, calm, noise, level, partial(learn_errors, errors_of_calm(sides[0])))
    return conclude(sides, noise, test, layout, calm, registration)


def conclude(sides: tuple[Side, Side], noise: Noise, test: Tested, layout: Layout, calm: Masks,
             registration: Registration, own: tuple[Side, Side] | None = None) -> Detected:  # fmt: skip
    """Return the answer for both sides, as the test says: what is deep, and of the rest, which is tested again without
    it, what is significant by itself. `own` are the sides without the motion of the whole, where one is left."""
    n_vertices, own = larger_of(sides), own or sides
    levels = map_sides(lambda k: level_at(sides[k], noise), n_vertices)
    deep = all_deep(sides, levels, test.far)
    rest = test
    if deep[0].any() or deep[1].any():
        without = lay_out_without(layout, sides, deep, registration)
        rest = judge_units(without, sides, calm, noise, test.level, lambda _: test.errors, test.scans)
    found = map_sides(lambda k: mark_changed(sides[k], own[k], rest, k, levels[k], deep[k], noise, calm[k]), n_vertices)
    return Detected(found, noise, test, layout, calm)


def without_plain(masks: Masks, plain: Masks | None) -> Masks:
    """Return the masks of both sides without what changed plainly."""
    return masks if plain is None else (masks[0] & ~plain[0], masks[1] & ~plain[1])


def stable_or_all(side: Side) -> Bools:
    """Return the assessed vertices that the registration holds stable; all assessed ones where it holds none."""
    stable = side.is_stable & side.is_assessed
    return stable if stable.any() else side.is_assessed


def lay_out(sides: tuple[Side, Side], noise: Noise, registration: Registration, last: Layout | None) -> Layout:
    """Return the patches to test where errors agree as in `noise`; the last ones where units come out as large."""
    size = unit_size(noise.correlation, np.concatenate([s.areas[s.is_assessed] for s in sides]))
    return last if last is not None and last.size == size else lay_out_patches(sides, size, registration)


def judge_units(layout: Layout, sides: tuple[Side, Side], calm: Masks, noise: Noise, level: float,
                errors_of: Callable[[Both], tuple[PatchErrors, ...]],
                scans: ScanErrors | None = None) -> Tested:  # fmt: skip
    """Test the patches of every size of both sides, all at once; `errors_of` says how those of each size scatter,
    `scans` what their scans err by, None as the patches that hold still show it."""

    def measure(k: int) -> tuple[Units, Patches]:
        """Return the units of side k with their noise, and their patches measured."""
        units = judge_noise(layout.units[k], sides[k], noise, calm[k])
        return units, measure_patches(layout.outlines[k], units, layout.reaches[k], noise.correlation, AS_STATED)

    n_vertices = larger_of(sides)
    (first_units, first), (second_units, second) = map_sides(measure, n_vertices)
    if scans is None:
        scans = scans_of_still((first, second), (first_units, second_units), sides[0].n_scans)
    both = (replace(first, scans=scans), replace(second, scans=scans))
    errors = errors_of(both)

    def ask(k: int) -> tuple[Floats, Floats, Floats]:
        """Return the p-values (p,) of the patches of side k, and the least of the patches of each unit."""
        p_values = _test(both[k], errors)
        return p_values, *least_of_patches(layout.reaches[k], both[k].means, p_values)

    a, b = map_sides(ask, n_vertices)
    tested = np.concatenate([a[0][first.is_whole], b[0][second.is_whole]])
    beyond = [p.is_whole[:, 0] & (np.abs(p.means[:, 0]) > BESIDE * errors[0].scales[p.kinds] * p.sigmas[:, 0])
              for p in both]  # fmt: skip
    far = far_levels(sum(int(s.is_assessed.sum()) for s in sides), level)
    limit = benjamini_hochberg(tested, level)
    return Tested((first_units, second_units), layout.reaches, (a[1], b[1]), (a[2], b[2]), limit, layout.size, errors,
                  scans, len(tested), (a[0], b[0]), (beyond[0], beyond[1]), far, level,
                  (first.is_whole[:, 0], second.is_whole[:, 0]))  # fmt: skip


def errors_of_calm(side: Side) -> LearnErrors:
    """Return how the scatter of calm patches is learned: with its tails where no points bear out what is told."""
    return calm_errors if side.states_noise else tailed_errors


def learn_errors(learn: LearnErrors, both: Both) -> tuple[PatchErrors, ...]:
    """Return how the patches of each size scatter, learned from the calm ones of both sides."""
    z = np.concatenate([np.where(p.is_whole & p.is_calm, p.means / p.sigmas, np.nan) for p in both])
    kinds = np.concatenate([p.kinds for p in both])
    return tuple(learn(of_size[~np.isnan(of_size)], kinds[~np.isnan(of_size)]) for of_size in z.T)


def scans_of_still(both: Both, units: tuple[Units, Units], n_scans: int) -> ScanErrors:
    """Return what the patches of both sides that hold still show of the errors of `n_scans` scans, 0 if not known."""
    of_still = [(np.where(p.is_whole & p.is_still, p.means, np.nan), p.own2, p.stated) for p in both]
    means, own2, stated = (np.concatenate(columns) for columns in zip(*of_still, strict=True))
    areas, calm = (np.concatenate(columns) for columns in zip(*((u.areas, u.calm_shares) for u in units), strict=True))
    return learn_scans(means, own2, stated, float(areas @ calm) / max(float(areas.sum()), 1e-300), n_scans)


def _test(patches: Patches, errors: tuple[PatchErrors, ...]) -> Floats:
    """Return the p value of each patch (p, s), 1 for scraps."""
    z = patches.means / patches.sigmas
    columns = map_threads(lambda k: errors[k].p_values(z[:, k], patches.kinds, patches.dofs[:, k]), range(len(errors)))
    return np.where(patches.is_whole, np.column_stack(columns), 1.0)


def find_rest(sides: tuple[Side, Side], test: Tested, layout: Layout, noise: Noise, calm: Masks,
              registration: Registration, plain: Masks | None) -> tuple[Masks | None, Masks | None]:  # fmt: skip
    """Return which vertices of both sides lie away from all that is significant or suspect, None where these are too
    few to teach, and which changed surely, where patches that hold some of these do not teach; None: all patches do.

    Wide patches that reach into a deep change are significant as far as they are wide, on a small object all over it.
    Where that leaves too little, patches without what changed surely say what lies away from the rest.
    """
    rest = without_plain(away_from_both(sides, test), plain)
    if can_teach(rest, sides, test):
        return rest, None
    sure = changed_surely(sides, test, noise)
    sure = sure if plain is None else (sure[0] | plain[0], sure[1] | plain[1])
    if not (sure[0].any() or sure[1].any()):
        return None, None
    without = lay_out_without(layout, sides, sure, registration)
    beside = judge_units(without, sides, calm, noise, test.level, lambda _: test.errors, test.scans)
    is_stated = sides[0].states_noise
    rest = away_from_both(sides, beside) if is_stated else away_from_suspect(sides, test, beside, sure)
    return (rest, sure) if can_teach(rest, sides, beside) else (None, None)


def changed_surely(sides: tuple[Side, Side], test: Tested, noise: Noise) -> Masks:
    """Return which vertices of both sides changed surely, so that patches without them tell of the rest: what is deep.

    Where no noise is stated that is too much and too little: what two meshes of one edge differ by is as deep, one
    vertex beside another, and their level would be that of smooth places. Units that are suspect by themselves then.
    """
    deep = all_deep(sides, map_sides(lambda k: level_at(sides[k], noise), larger_of(sides)), test.far)
    return deep if sides[0].states_noise else map_sides(lambda k: suspect_alone(test, k, deep[k]), larger_of(sides))


def judge_beside(sure: Masks | None, layout: Layout, sides: tuple[Side, Side], calm: Masks, noise: Noise,
                 level: float, registration: Registration) -> Tested:  # fmt: skip
    """Test all patches, by errors that patches without what changed surely (`sure`, None: nothing) show; where no noise
    is stated, and tails are learned, patches of what is calm alone: others may be flanks by half."""
    learn = partial(learn_errors, errors_of_calm(sides[0]))
    if sure is None:
        return judge_units(layout, sides, calm, noise, level, learn)
    left_out = sure if sides[0].states_noise else (~calm[0], ~calm[1])
    beside = judge_units(lay_out_without(layout, sides, left_out, registration), sides, calm, noise, level, learn)
    return judge_units(layout, sides, calm, noise, level, lambda _: beside.errors, beside.scans)


def all_deep(sides: tuple[Side, Side], levels: tuple[Floats, Floats], far: float) -> Masks:
    """Return which vertices (n,) of both sides are so far off zero that they need no patch; see `find_deep`."""
    return map_sides(lambda k: find_deep(sides[k], levels[k], far), larger_of(sides))
