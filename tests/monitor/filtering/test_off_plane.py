"""What stays of a relief finer than the points resolve, by the kernels that decide it, on turned neighbourhoods."""

import numpy as np
import pytest

from monitor.filtering import off_plane, tangents
from monitor.filtering.covariance import moments
from monitor.filtering.sizes import clean_limits
from projects.transforms import rotation_from_vector

SCALE = 0.01  # of the spacing of the points: one sigma across the plane
ALL = [(u, v) for u in (-1, 0, 1) for v in (-1, 0, 1) if (u, v) != (0, 0)]
STRAIGHT, OBLIQUE = [p for p in ALL if 0 in p], [p for p in ALL if 0 not in p]


def neighbourhood(rng, raised, gap=0.0):
    """Return points (n, 3) of a grid of 9 x 9 about the first, some `raised` {place: height}, turned anyhow; which of
    them are of the plane. Of the plane none is left in a wedge of `gap` [rad], or nearer than 3 if there is one."""
    u, v = (a.ravel().astype(float) for a in np.meshgrid(np.arange(-4, 5), np.arange(-4, 5)))
    height = np.array([raised.get((int(a), int(b)), 0.0) for a, b in zip(u, v, strict=True)])
    flat = height == 0.0
    kept = ~(flat & (np.abs(np.arctan2(v, u)) < 0.5 * gap))
    order = np.argsort(np.hypot(u, v)[kept], kind="stable")
    points = np.c_[u, v, height + np.where(flat, SCALE * rng.normal(size=len(u)), 0.0)][kept][order]
    turned = (points - points[0]) @ rotation_from_vector(rng.normal(size=3)).T
    return turned, flat[kept][order]


def is_relief(points, flat, is_line=False):
    """Tell whether the first point is of a relief on the plane of the flat ones."""
    x, y, z = np.ascontiguousarray(points.T)
    _, m, c = moments(x, y, z, flat.astype(float), len(x))
    return off_plane.is_relief(x, y, z, len(x), (m, c), SCALE, is_line, np.empty(len(x)), np.empty(len(x)))


def row_of(points):
    """Return the row of the first of the points, all of them its neighbours, by the names of its columns."""
    n = len(points)
    near, sizes, noise = np.arange(n, dtype=np.int32)[None], np.array([n], dtype=np.int32), np.array([SCALE])
    rows = tangents.fit_tangents(points, np.zeros(1, dtype=np.int64), near, sizes, noise, clean_limits(n), 0.55)
    return dict(zip(tangents.COLUMNS, rows[0], strict=True))


@pytest.mark.parametrize(
    ("beside", "below", "expected"),
    [(STRAIGHT, [], True), (OBLIQUE, [], True), (STRAIGHT[:3], [], False), ([], [], False), (ALL, [], True),
     (STRAIGHT[:3], OBLIQUE[:1], False), (STRAIGHT[:3], OBLIQUE, False), (STRAIGHT, OBLIQUE, True)],
)  # fmt: skip
def test_a_relief_has_half_of_the_nearest_points_on_its_side_of_the_plane(rng, beside, below, expected):
    raised = {(0, 0): 0.5, **dict.fromkeys(beside, 0.3), **dict.fromkeys(below, -0.3)}
    for sign in (1.0, -1.0):
        turned = {place: sign * height for place, height in raised.items()}
        assert all(is_relief(*neighbourhood(rng, turned)) == expected for _ in range(20))


@pytest.mark.parametrize(("degrees", "expected"), [(20.0, True), (57.0, True), (63.0, False), (80.0, False)])
def test_a_relief_rises_by_no_more_than_sixty_degrees_from_the_nearest_point_of_the_plane(rng, degrees, expected):
    high = np.tan(np.radians(degrees))
    near = {(0, 0): high, **dict.fromkeys(OBLIQUE, 0.3)}  # the plane at a distance of one
    far = {(0, 0): 2.0 * high, **dict.fromkeys(ALL, 0.3)}  # of two
    for raised in (near, far):
        assert all(is_relief(*neighbourhood(rng, raised)) == expected for _ in range(20))


@pytest.mark.parametrize(("degrees", "expected"), [(0.0, True), (120.0, True), (200.0, False), (300.0, False)])
def test_a_relief_has_its_plane_all_around(rng, degrees, expected):
    raised = {(0, 0): 0.5, **dict.fromkeys(ALL, 0.3)}
    assert all(is_relief(*neighbourhood(rng, raised, np.radians(degrees))) == expected for _ in range(20))
    line = dict.fromkeys([(0, k) for k in range(-4, 5)], 0.5)
    assert all(is_relief(*neighbourhood(rng, line, np.radians(degrees)), is_line=True) == expected for _ in range(20))


def test_the_widest_turn_is_that_between_sorted_angles(rng):
    for n in (1, 2, 3, 9):
        for _ in range(50):
            angles = rng.uniform(-np.pi, np.pi, n)
            turns = np.sort(angles % (2.0 * np.pi))
            expected = np.diff(np.append(turns, turns[0] + 2.0 * np.pi)).max()
            assert off_plane.widest_turn(angles) == pytest.approx(expected)
    assert off_plane.widest_turn(np.zeros(0)) == 2.0 * np.pi


def test_a_vector_across_is_a_unit_vector_and_across(rng):
    for v in (*np.eye(3), *-np.eye(3), *(w / np.linalg.norm(w) for w in rng.normal(size=(20, 3)))):
        found = np.array(off_plane.across(tuple(v)))
        assert np.linalg.norm(found) == pytest.approx(1.0)
        assert found @ v == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("tilt", [0.0, 0.05])
def test_a_line_over_a_plane_has_the_plane_of_the_points_around_it(rng, tilt):
    line = {(0, k): 0.6 + tilt * k for k in range(-4, 5)}
    for _ in range(20):
        points, flat = neighbourhood(rng, line)
        row = row_of(points)
        assert row["state"] == tangents.SECOND
        assert flat.sum() - 3 <= row["n_inliers"] <= flat.sum()  # but for what lies beyond three sigmas
        assert row["height"] == 0.0
        normal = np.array([row["nx"], row["ny"], row["nz"]])
        assert np.abs(points[flat] @ normal - np.median(points[flat] @ normal)).max() < 6.0 * SCALE


def test_a_line_of_a_scan_far_over_a_plane_is_its_own_and_counts_its_own_points(rng):
    """Its noise is along the beams: it lies in a plane with the scanner."""
    points, _ = neighbourhood(rng, {(0, k): 3.0 + SCALE * rng.normal() for k in range(-4, 5)})
    row = row_of(points)
    assert row["state"] == tangents.SECOND
    assert row["n_inliers"] == 9


def is_on_line(rng, places, heights):
    """Tell whether the first of some points over a plane, at places (k, 2) and heights (k,), lies on a line of them."""
    flat = np.c_[rng.uniform(-4.5, 4.5, (60, 2)), SCALE * rng.normal(size=60)]
    points = np.r_[np.c_[places, heights], flat] - [*places[0], heights[0]]
    x, y, z = np.ascontiguousarray((points @ rotation_from_vector(rng.normal(size=3)).T).T)
    n, scratch = len(x), np.empty((3, len(x)))
    _, m, c = moments(x, y, z, (np.arange(n) >= len(places)).astype(float), n)
    return off_plane.is_on_line(x, y, z, n, (m, c), 5.0, SCALE, *scratch)


@pytest.mark.parametrize(
    ("n", "across", "aside", "expected"),
    [(9, 1.0, 0.0, True), (6, 1.0, 0.0, True), (5, 1.0, 0.0, False), (9, 6.0, 0.0, False), (9, 1.0, 2.0, True),
     (9, 1.0, 8.0, False)],
)  # fmt: skip
def test_a_line_is_narrow_and_goes_through_the_point(rng, n, across, aside, expected):
    """`across` and `aside` in sigmas: what its points scatter by, and by how much the point itself lies off them."""
    found = []
    for _ in range(40):
        along = np.r_[0.0, np.arange(1, n) * np.where(np.arange(1, n) % 2, 0.5, -0.5)]
        scatter = across * SCALE * np.where(np.arange(n) // 2 % 2, 1.0, -1.0) + 0.1 * SCALE * rng.normal(size=n)
        scatter[0] = aside * SCALE
        found.append(is_on_line(rng, np.c_[scatter, along], np.full(n, 0.6)))
    assert np.mean(found) == (1.0 if expected else 0.0)


def test_a_stray_beside_a_line_does_not_break_it(rng):
    """It lies off the plane too, but not as far."""
    places = np.r_[np.c_[np.zeros(9), np.r_[0.0, np.arange(1, 9) * 0.5]], [[0.7, 0.2]]]
    assert all(is_on_line(rng, places, np.append(np.full(9, 0.6), 0.1)) for _ in range(20))


def test_strays_here_and_there_stay_outliers(rng):
    """A tenth of all points, anywhere up to one and a half spacings off the plane: of half of the nearest none are."""
    kept = []
    for _ in range(200):
        strays = {
            p: rng.uniform(0.1, 1.5) for p in [(a, b) for a in range(-4, 5) for b in range(-4, 5)] if rng.random() < 0.1
        }
        points, _ = neighbourhood(rng, {**strays, (0, 0): rng.uniform(0.1, 1.5)})
        kept.append(row_of(points)["state"] != tangents.OUTLIER)
    assert np.mean(kept) < 0.04
