"""What the truth says of single scans: which of two stations sees a point, and where ranges jump within a beam."""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

from scan_to_scan import Differences, _assessed, _look, rows_of, true_motions

from monitor.simulation import Scene, Station
from monitor.simulation.scanner import Target, misregister
from monitor.simulation.scenes import make_box
from projects.model import Surface


def test_a_point_is_seen_where_nothing_stands_before_it_and_free_where_no_range_jumps_near_it() -> None:
    wall = make_box("wall", [-1.0, 3.0, -1.0], [1.0, 3.1, 1.0])
    post = make_box("post", [-0.1, 2.9, -1.0], [0.1, 2.95, 1.0])
    target = Target.of(Scene("wall and post", (wall, post)), 1)
    edge = 0.1 * 3.0 / 2.9  # the shadow of the post on the wall, from the origin
    x = np.array([0.0, edge - 0.001, edge + 0.001, edge + 0.0035, 0.5, 0.9985])
    points = np.column_stack([x, np.full(6, 3.0), np.zeros(6)])
    sees, free = _look(target, np.zeros(3), points, np.tile([0.0, -1.0, 0.0], (6, 1)))
    np.testing.assert_array_equal(sees, [False, False, True, True, True, True])
    np.testing.assert_array_equal(free, [False, False, False, True, True, False])  # the wall ends 1.5 mm further
    assert not _look(target, np.zeros(3), points, np.tile([0.0, 1.0, 0.0], (6, 1)))[0].any()  # turned away


def test_true_motions_take_a_stated_pose_to_the_true_one() -> None:
    pose = np.eye(4)
    pose[:3, 3] = [1.0, 2.0, 0.5]
    stated = misregister(pose, np.random.default_rng(1), sigma_position=0.01, sigma_angle=0.01)
    moved, still = true_motions([Station("a", pose, 0.001, stated), Station("b", pose, 0.001)])
    np.testing.assert_allclose(moved @ stated, pose, atol=1e-12)
    np.testing.assert_array_equal(still, np.eye(4))


def test_rows_share_out_what_lies_beyond_a_millimetre() -> None:
    distances = np.array([0.0002, -0.0005, 0.003, -0.002, 0.0015, 0.0001, 0.0, 0.0, 0.0, 0.0, 0.009, 0.0])
    assessed = np.array([1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0], dtype=bool)
    both = np.array([1, 1, 0, 0, 1, 1, 1, 1, 1, 1, 1, 1], dtype=bool)
    free = np.array([1, 1, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1], dtype=bool)
    registered = Differences(distances, assessed, both, free)
    better = Differences(np.where(distances == 0.0015, 0.0009, distances), assessed, both, free)
    rows = rows_of(registered, better)
    assert [row.ours for row in rows] == ["70.0%", "83%", "66.7%", "80.0%", "100.0%", "100.0%"]
    assert rows[0].verdict == "not yet"
    assert rows[0].cause.startswith("67% of what lies beyond 1 mm")
    assert rows[0].cause.endswith("the registration takes 10.0 % of the whole")


def test_two_models_are_compared_both_ways_and_only_where_compare_says_something() -> None:
    """A sheet of 0.2 m over one of 0.3 m: the small one's rim and what lies beyond it are not assessed."""
    small, large = make_sheet(0.1, 0.0004), make_sheet(0.15, 0.0)
    on_small, on_large = _assessed(small, large)
    far = np.abs(large.vertices[:, :2]).max(axis=1)
    assert not on_large[far > 0.1].any()
    assert on_large[far < 0.09].all()
    edge = np.abs(small.vertices[:, :2]).max(axis=1)
    assert not on_small[edge > 0.0999].any()
    assert on_small[edge < 0.09].all()


def make_sheet(half: float, height: float) -> Surface:
    """Return a square sheet of some 3 mm fields with a stated sigma of 0.2 mm."""
    n = round(2.0 * half / 0.003) + 1
    x, y = (a.ravel() for a in np.meshgrid(*[np.linspace(-half, half, n)] * 2, indexing="ij"))
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.vstack([np.column_stack([a, a + n, a + n + 1]), np.column_stack([a, a + n + 1, a + 1])])
    return Surface(np.column_stack([x, y, np.full(len(x), height)]), faces, sigma=np.full(len(x), 2e-4))
