"""Targets and control points in one adjustment with surfaces: datum, weights, blunders, covariance, refusal."""

import dataclasses

import numpy as np
import pytest
from network_of_caps import (
    displaced,
    known_points,
    noisy_caps,
    pose_errors,
    seen_targets,
    simulate_network,
    small_motion,
    target_places,
)
from scipy.stats import chi2

from monitor.registration.network.adjustment import Adjustment, AdjustmentSettings, adjust_scans
from monitor.registration.network.equations import (
    Scales,
    Solution,
    TieScales,
    as_of_three,
    estimate_prior,
    prior_weights,
    solve_network,
    tie_equations,
    tie_statistics,
    uncontrolled,
)
from monitor.registration.network.network_covariance import absorbed_motions
from monitor.registration.network.placing import place_scans
from monitor.registration.network.ties import identify_targets, no_ties, why_none_is_known
from projects.model import ControlPoint, PointCloud, SurveyTarget
from projects.transforms import apply, perturb

FEW = AdjustmentSettings(n_samples=1500)


def adjusted(rng: np.random.Generator, *, shift: np.ndarray | None = None, wrong: tuple[int, int] | None = None,
             wrong_control: int | None = None) -> tuple[Adjustment, list[np.ndarray]]:  # fmt: skip
    """Return an adjustment of three caps with six targets under control, and the pose errors. `wrong` is a target
    (scan, point) that is 8 mm off, `wrong_control` a control point that is 15 mm off."""
    clouds, errors, places = noisy_caps(rng, 3, None), pose_errors(rng, 3), target_places(6)
    if shift is not None:
        errors = [perturb(E, np.zeros(3), np.concatenate([np.zeros(3), shift])) for E in errors]
    seen, control = seen_targets(rng, places, errors), list(known_points(rng, places))
    if wrong is not None:
        target = seen[wrong[0]][wrong[1]]
        seen[wrong[0]][wrong[1]] = dataclasses.replace(target, centre=target.centre + np.array([0.005, -0.005, 0.004]))
    if wrong_control is not None:
        point = control[wrong_control]
        control[wrong_control] = dataclasses.replace(point, position=point.position + np.array([0.0, 0.009, 0.012]))
    given = [displaced(c, E) for c, E in zip(clouds, errors, strict=True)]
    return adjust_scans(given, FEW, identify_targets(seen, control)), errors


def worst_place(found: Adjustment, errors: list[np.ndarray]) -> float:
    """Return the largest way [m] from the truth, of points half a metre from the middle."""
    left = [small_motion(M @ E, np.zeros(3)) for M, E in zip(found.motions, errors, strict=True)]
    return float(max(np.linalg.norm(e[3:]) + 0.5 * np.linalg.norm(e[:3]) for e in left))


def test_control_points_bring_the_whole_to_its_place(rng: np.random.Generator) -> None:
    found, errors = adjusted(rng, shift=np.array([0.03, -0.02, 0.01]))
    assert found.applied
    assert worst_place(found, errors) < 0.001  # control has 0.5 mm; as given the whole is 37 mm off
    assert np.sqrt(np.trace(found.covariance[3:, 3:]) / 3) < 0.0005
    assert found.blunders == ()


def test_wrong_target_is_named_and_left_out(rng: np.random.Generator) -> None:
    found, errors = adjusted(rng, wrong=(1, 4))
    assert [(t.scan, t.name) for t in found.blunders] == [(1, "P4")]
    assert worst_place(found, errors) < 0.001


def test_wrong_control_point_is_named_and_left_out(rng: np.random.Generator) -> None:
    found, errors = adjusted(rng, wrong_control=2)
    assert [(t.scan, t.name) for t in found.blunders] == [(-1, "P2")]
    assert worst_place(found, errors) < 0.001


def test_targets_without_control_hold_scans_that_do_not_overlap(rng: np.random.Generator) -> None:
    caps = noisy_caps(rng, 2, None)
    errors, places = pose_errors(rng, 2), target_places(5)
    facing = [c.take(c.points @ np.array([s, 0, 0]) > 0.25) for c, s in zip(caps, (1.0, -1.0), strict=True)]
    given = [displaced(c, E) for c, E in zip(facing, errors, strict=True)]
    found = adjust_scans(given, FEW, identify_targets(seen_targets(rng, places, errors)))
    assert found.applied
    left = [M @ E for M, E in zip(found.motions, errors, strict=True)]
    apart = apply(left[0], places) - apply(left[1], places)
    assert np.abs(apart).max() < 0.001  # targets have 0.2 mm; as given 5 mm
    assert np.isnan(found.covariance).all()


def test_too_small_sigmas_are_raised_by_their_variance_component(rng: np.random.Generator) -> None:
    clouds, errors, places = noisy_caps(rng, 4, None), pose_errors(rng, 4), target_places(9)
    seen = seen_targets(rng, places, errors)
    stated = [[dataclasses.replace(t, covariance=t.covariance / 25.0) for t in scan] for scan in seen]
    given = [displaced(c, E) for c, E in zip(clouds, errors, strict=True)]
    honest, bold = (adjust_scans(given, FEW, identify_targets(s)).components.targets for s in (seen, stated))
    assert honest == pytest.approx(1.0, abs=0.6)
    assert 10.0 < bold < 45.0  # 25


def turned_about_control(rng: np.random.Generator, known: np.ndarray, turn: float) -> tuple[Adjustment, np.ndarray]:
    """Return an adjustment of three caps whose common frame is turned by `turn` [rad] about the line from the first to
    the last of the control points `known` (k, 3) [m], and the motion (6,) left of the whole about its centre."""
    line = known[-1] - known[0] if len(known) > 1 else np.array([0.0, 0.0, 1.0])
    common = perturb(np.eye(4), known[0], np.concatenate([turn * line / np.linalg.norm(line), np.zeros(3)]))
    clouds = noisy_caps(rng, 3, None)
    errors = [common @ E for E in pose_errors(rng, 3)]
    ties = identify_targets(seen_targets(rng, known, errors), known_points(rng, known))
    found = adjust_scans([displaced(c, E) for c, E in zip(clouds, errors, strict=True)], FEW, ties)
    centre = np.nan_to_num(found.centre)
    return found, np.mean([small_motion(M @ E, centre) for M, E in zip(found.motions, errors, strict=True)], axis=0)


@pytest.mark.parametrize("known", [
    target_places(6)[:1], target_places(6)[:2],
    target_places(6)[0] + np.linspace(0.0, 1.0, 4)[:, None] * (target_places(6)[1] - target_places(6)[0]),
])  # fmt: skip
def test_control_that_leaves_a_turn_free_does_not_say_how_sure_the_whole_is(
    rng: np.random.Generator, known: np.ndarray
) -> None:
    found, left = turned_about_control(rng, known, 0.005)
    assert found.applied
    assert np.linalg.norm(left[:3]) > 0.003  # rad, of 0.005 that nothing shows; it was stated to 0.0005
    assert np.isnan(found.covariance).all()
    assert np.isfinite(found.covariances).all()  # of each against the mean of all


@pytest.mark.parametrize("aside", [0.1, 0.5, 1.0])
def test_the_frame_as_given_draws_nothing_back_that_control_holds(aside: float) -> None:
    """Three control points, one of them `aside` [m] of the line of the others, about which the frame as given is turned
    by 20 mrad: 15 of them were left, under a control that was held to be six times as poor as stated."""
    known = np.array([[-1.0, 0.9, 0.1], [0.0, 0.9 + aside, 0.1], [1.0, 0.9, 0.1]])
    statistics = []
    for seed in (1, 3):
        found, left = turned_about_control(np.random.default_rng(seed), known, 0.02)
        assert abs(left[0]) < 3.0 * 0.0015 / aside  # 0.6 mm of control and targets across, on 2/3 of the way aside
        statistics.append(left @ np.linalg.solve(found.covariance, left))
    assert max(statistics) < chi2.ppf(0.999, 6)


def test_a_scan_without_targets_goes_with_the_others_that_control_moves_far(rng: np.random.Generator) -> None:
    """The frame as given lies 0.4 m off: the third cap stayed there, beyond the reach of the others' surfaces."""
    places, clouds = target_places(6), noisy_caps(rng, 3, None)
    errors = [perturb(E, np.zeros(3), np.array([0, 0, 0, 0.4, 0, 0])) for E in pose_errors(rng, 3)]
    seen = [*seen_targets(rng, places, errors)[:2], []]
    ties = identify_targets(seen, known_points(rng, places))
    found = adjust_scans([displaced(c, E) for c, E in zip(clouds, errors, strict=True)], FEW, ties)
    assert worst_place(found, errors) < 0.001  # control has 0.5 mm


def test_the_truth_lies_in_the_ellipsoids_of_a_network_with_control() -> None:
    each, whole = zip(*(simulate_network(seed, 0.03, is_absolute=True) for seed in range(4)), strict=True)
    assert np.mean(np.array(each) < chi2.ppf(0.95, 6)) >= 0.8
    assert 1.0 < np.mean(each) < 10.0  # 6
    assert max(whole) < chi2.ppf(0.999, 6)


@pytest.mark.slow
@pytest.mark.parametrize("is_absolute", [False, True])
def test_the_true_poses_lie_in_the_95_percent_ellipsoids_as_often_as_stated(is_absolute: bool) -> None:
    each, _ = zip(*(simulate_network(seed, 0.03, is_absolute=is_absolute) for seed in range(60)), strict=True)
    # 90 to 99 % are asked for in 200 simulations; of 60 times four, not independent, a standard deviation is 2 %
    assert np.mean(np.array(each) < chi2.ppf(0.95, 6)) >= 0.88


def test_targets_placed_alike_on_both_sides_are_those_where_the_scan_was_given(rng: np.random.Generator) -> None:
    # of control the scan sees Q alone; three of its targets lie as control does, mirrored about x = 0
    known = {"P": (-9.0, -4.0, 1.2), "Q": (3.0, -4.0, 1.2), "R": (-5.0, -6.5, 0.2)}
    seen = {"other": (-3.0, -4.0, 1.2), "Q": (3.0, -4.0, 1.2), "far": (9.0, -4.0, 1.2), "foot": (5.0, -6.5, 0.2)}
    control = [ControlPoint(name, np.array(at), 0.0005) for name, at in known.items()]
    sigma = np.eye(3) * 0.0003**2
    targets = [
        SurveyTarget("sphere", np.array(at) + rng.normal(0, 0.0003, 3) + 0.01, sigma, 0.07, 0.001, 100, 1.0)
        for at in seen.values()
    ]
    ties = identify_targets([targets], control)
    assert [ties.names[p] for p in ties.point] == ["Q"]
    # where nothing lies on control as given, the frames differ and the invariants decide
    away = [dataclasses.replace(t, centre=t.centre + 0.7) for t in targets]
    ties = identify_targets([away], control)
    assert sorted(ties.names[p] for p in ties.point) == ["P", "Q", "R"]


def test_targets_are_identified_by_invariants_however_far_the_poses_are_off(rng: np.random.Generator) -> None:
    places = target_places(6)
    errors = [np.eye(4), perturb(np.eye(4), np.zeros(3), np.array([0.5, 1.2, -0.3, 4.0, -2.0, 1.0]))]
    control = tuple(ControlPoint(f"P{k}", p) for k, p in enumerate(places))
    seen = seen_targets(rng, places, errors)
    ties = identify_targets([seen[0], seen[1][::-1]], control)
    named = [(int(s), ties.names[p]) for s, p in zip(ties.scan, ties.point, strict=True)]
    assert sorted(named) == sorted((s, f"P{k}") for s in (0, 1) for k in range(6))


def test_control_whose_axes_are_exchanged_is_said_to_be_mirrored(rng: np.random.Generator) -> None:
    places = target_places(6)
    seen = seen_targets(rng, places, [np.eye(4)] * 2)
    exchanged = known_points(rng, places[:, [1, 0, 2]])
    assert not identify_targets(seen, exchanged).has_control.any()
    assert "mirrored: 6 of 6 and 6 agree" in why_none_is_known([seen[0][:2], seen[1]], exchanged)
    assert why_none_is_known([seen[0][:2]], exchanged).startswith("2 and 6 points; three or more")
    assert why_none_is_known([[], []], exchanged) == why_none_is_known(seen, known_points(rng, places)) == ""


def test_two_targets_beside_each_other_are_not_confused(rng: np.random.Generator) -> None:
    places = np.array([[0.0, 0, 0], [0.08, 0, 0], [1.0, 0.3, 0.2]])
    shifted = perturb(np.eye(4), np.zeros(3), np.array([0.0, 0, 0, 0.02, 0, 0]))
    ties = identify_targets(seen_targets(rng, places, [np.eye(4), shifted]))
    assert sorted(zip(ties.scan.tolist(), ties.point.tolist(), strict=True)) == [
        (s, p) for s in (0, 1) for p in range(3)
    ]


def test_scans_without_poses_are_placed_one_after_the_other_by_shared_targets(rng: np.random.Generator) -> None:
    places = rng.uniform([-8, -3, 0], [8, 3, 3], (12, 3))
    truth = [perturb(np.eye(4), np.zeros(3), rng.normal(0, 2.0, 6)) for _ in range(3)]
    inverse = [np.linalg.inv(T) for T in truth]
    # the first sees the control points, the second shares none of them with it, the third nothing with the first
    shares = (range(0, 7), range(3, 11), range(7, 12))
    seen = [seen_targets(rng, places[list(s)], [E])[0] for s, E in zip(shares, inverse, strict=True)]
    control = known_points(rng, places[:4])
    found = place_scans(seen, [None, None, None], control)
    assert found.reasons == ("", "", "")
    for pose, T in zip(found.poses, truth, strict=True):
        assert np.abs(apply(pose @ np.linalg.inv(T), places) - places).max() < 0.01


def test_scan_that_shares_two_targets_only_is_not_placed(rng: np.random.Generator) -> None:
    places = rng.uniform([-8, -3, 0], [8, 3, 3], (7, 3))
    seen = seen_targets(rng, places, [np.eye(4)] * 2)
    found = place_scans([seen[0][:5], seen[1][3:]], [np.eye(4), None])
    assert np.isnan(found.poses[1]).all()
    assert "agree" in found.reasons[1]


def test_target_seen_once_ties_nothing(rng: np.random.Generator) -> None:
    lonely = SurveyTarget("sphere", np.array([9.0, 0, 0]), np.eye(3) * 1e-8, 0.0725, 1e-4, 100, 1.0)
    assert len(identify_targets([[lonely], []])) == 0


def test_rows_of_ties_are_the_derivative_of_their_misclosures(rng: np.random.Generator) -> None:
    places, errors = target_places(4), pose_errors(rng, 2, 0.3, 0.5)
    ties = identify_targets(seen_targets(rng, places, [np.eye(4)] * 2), known_points(rng, places))
    at = tie_equations(ties, errors, places, lever=2.0)
    step = 1e-6
    for u in range(at.rows.shape[2]):
        moved, there = list(errors), places.copy()
        if u < 12:
            delta = np.zeros(6)
            delta[u % 6] = step / (2.0 if u % 6 < 3 else 1.0)
            moved[u // 6] = perturb(moved[u // 6], np.zeros(3), delta)
        else:
            there[(u - 12) // 3, (u - 12) % 3] += step
        change = (tie_equations(ties, moved, there, lever=2.0).misclosures - at.misclosures) / step
        assert np.abs(change - at.rows[:, :, u]).max() < 1e-5


def test_the_sigma_of_poses_as_given_is_what_the_motions_show(rng: np.random.Generator) -> None:
    n, turn, way = 8, 0.0004, 0.002
    motions = [perturb(np.eye(4), np.zeros(3), d) for d in rng.normal(0, [turn] * 3 + [way] * 3, (n, 6))]
    scales = Scales(1.0, np.full(2, 0.01), 1.0, 1.0, True)
    held = np.diag(prior_weights(scales, n))
    none = tie_equations(no_ties(), motions, np.empty((0, 3)), 1.0)
    known = Solution(np.zeros((n, 6)), np.empty((0, 3)), held + 1e12 * np.eye(6 * n), none, none.covariances)
    # 22 of 24 redundancies: one sigma of a sigma is 15 %
    assert estimate_prior(known, motions, scales) == pytest.approx([turn, way], rel=0.45)
    free = Solution(np.zeros((n, 6)), np.empty((0, 3)), held, none, none.covariances)
    assert np.isinf(estimate_prior(free, motions, scales)).all()  # nothing is told beyond the poses themselves


def test_redundancies_sum_up_to_the_surplus_of_observations(rng: np.random.Generator) -> None:
    places = target_places(5)
    ties = identify_targets(seen_targets(rng, places, [np.eye(4)] * 3), known_points(rng, places))
    scales = Scales(1.0, np.full(2, 1e3), 1.0, 1.0, False)
    solution = solve_network((np.zeros((18, 18)), np.zeros(18)), ties, places, [np.eye(4)] * 3, (scales, TieScales()))
    redundancy = tie_statistics(solution)[1]
    assert 3 * redundancy.sum() == pytest.approx(3 * 20 - (18 + 15), abs=1e-3)  # observations less unknowns


def test_what_is_checked_in_fewer_than_three_directions_is_as_seldom_beyond_chance_as_stated() -> None:
    """Three targets check each other in one or two directions: 0.3 % of right ones were beyond the 0.1 % limit."""
    statistics = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        places, motions = target_places(3), [np.eye(4)] * 2
        ties = identify_targets(seen_targets(rng, places, motions), known_points(rng, places))
        scales = Scales(1.0, np.full(2, 1e3), 1.0, 1.0, False)
        for _ in range(3):
            asked = (np.zeros((12, 12)), np.zeros(12)), ties, places, motions, (scales, TieScales())
            solution = solve_network(*asked)
            motions = [perturb(T, np.zeros(3), d) for T, d in zip(motions, solution.delta, strict=True)]
            places = places + solution.shift
        found, redundancy = tie_statistics(solution)
        statistics += found[~uncontrolled(redundancy)].tolist()
    assert np.median(statistics) == pytest.approx(chi2.median(3), rel=0.08)  # 0.87 of it as three times the mean
    assert np.mean(np.array(statistics) > chi2.isf(0.01, 3)) < 0.016  # 2.2 % so; 1800, in nines that go together


@pytest.mark.parametrize("freedom", [1, 2])
def test_a_gross_blunder_has_a_statistic_and_a_grosser_one_a_larger(freedom: int) -> None:
    told = [as_of_three(float(s), freedom) for s in (0.0, 1.0, 30.0, 999.0, 1001.0, 1e6)]
    assert told == sorted(told)
    assert chi2.sf(told[1:3], 3) == pytest.approx(chi2.sf([1.0, 30.0], freedom))
    assert told[4] - told[3] == pytest.approx(2.0, abs=0.01)
    assert np.isfinite(told).all()


def test_adjustment_that_does_not_settle_says_so(rng: np.random.Generator) -> None:
    clouds, errors = noisy_caps(rng, 3, None), pose_errors(rng, 3)
    given = [displaced(c, E) for c, E in zip(clouds, errors, strict=True)]
    found = adjust_scans(given, dataclasses.replace(FEW, max_iterations=1))
    assert not found.converged
    assert not found.applied
    assert "still moving" in found.reason
    assert all(np.array_equal(M, np.eye(4)) for M in found.motions)


def test_clouds_may_come_one_at_a_time(rng: np.random.Generator) -> None:
    clouds: list[PointCloud] = noisy_caps(rng, 3, None)
    one, other = adjust_scans(iter(clouds), FEW), adjust_scans(clouds, FEW)
    assert one.sigma_after == other.sigma_after


@pytest.mark.parametrize("n_others", [1, 3, 30])
def test_motions_against_many_scans_leave_residuals_to_learn_from(rng: np.random.Generator, n_others: int) -> None:
    absorbed = {other: rng.normal(size=(120, 6)) for other in range(n_others)}
    told = absorbed_motions(absorbed)
    own = sum(absorbed.values())
    assert 3 * told.shape[1] <= 120
    assert np.linalg.matrix_rank(told) == min(6 * n_others, 36)
    assert np.linalg.matrix_rank(np.hstack([told, own])) == np.linalg.matrix_rank(told)
