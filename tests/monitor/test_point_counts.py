"""What became of every point, as the report tells it: each column adds up, whatever the filter did."""

import datetime
from itertools import pairwise

import numpy as np
import pytest

from monitor.filtered_scans import ScanTask, filter_task
from monitor.filtering import FilterSettings, ThinningSettings, merge_scans
from monitor.repeats import RepeatsTask, repeats_task
from projects.model import EpochRecord, PointCloud, Scan, Step
from reports.history import EpochHistory, points_table

LEFT = ("measured points in the files", "left after filtering each scan", "left after merging")
METHODS = [("mode", False), ("voxel_median", False), ("mode", True)]


def scan_of(rng, xy, aside=0.0):
    """Return a wall seen from 3 m with 0.3 mm noise, three points in a pit, 25 twice and one stray in the air."""
    xy = np.where(np.linalg.norm(xy, axis=1)[:, None] < 0.004, xy + 0.01, xy)
    xy[25:28] = 0.0012 * np.array([[1, 0], [-0.5, 0.87], [-0.5, -0.87]]) + rng.normal(0, 1e-4, (3, 2))
    points = np.column_stack([xy, rng.normal(0, 0.0003, len(xy))])
    points[25:28, 2] -= 0.003
    points = np.concatenate([points, points[:25], [[0.0, 0.0, 0.3]]])
    return Scan(name="wall", cloud=PointCloud(points), pose=np.eye(4), origin=np.array([aside, 0.0, 3.0]))


def steps_of(rng, settings, is_repeated):
    """Return the steps that the chain leaves of two scans, each of which had 40 lines without a number."""
    xy = rng.uniform(-0.12, 0.12, (9000, 2))
    scans = [scan_of(rng, xy) if is_repeated else scan_of(rng, rng.uniform(-0.12, 0.12, (9000, 2)), aside)
             for aside in (0.0, 1.0)]  # fmt: skip
    n, unread = len(scans[0].cloud), {"not_measured_not_finite": 40}
    if is_repeated:
        made = [(repeats_task(RepeatsTask(tuple(scans), settings, {"read": 2 * n, "not_measured_not_finite": 80},
                                         (None, None))), None)]  # fmt: skip
    else:
        made = [filter_task(ScanTask(scan, settings, {"read": n, "outside_extent": 0, **unread})) for scan in scans]
    doubtful = [] if is_repeated else [d.noun for _, d in made]
    merged = merge_scans([m.noun for m, _ in made], settings, doubtful=doubtful)
    assert is_repeated or merged.counts["borne_out"] > 0
    raw = Step("r" * 16, "raw", counts={"n_points": 2 * n, "dropped": {"not finite": 80}})
    own = [Step("f" * 16, f"scan{k:03d}", counts=m.counts) for k, (m, _) in enumerate(made)]
    return (raw, *own, Step("m" * 16, "filtered", counts=merged.counts))


@pytest.mark.parametrize(("method", "is_repeated"), METHODS)
def test_in_is_out_and_all_reasons_together(rng, method, is_repeated):
    settings = FilterSettings(thinning=ThinningSettings(method=method, target_spacing=0.005))
    record = EpochRecord("wall", "e", datetime.date(2026, 1, 1), repeated=is_repeated)
    epoch = EpochHistory(record, steps_of(rng, settings, is_repeated))
    rows = [(row[0], int("".join(filter(str.isdigit, row[1])))) for row in points_table((epoch, epoch)).rows]
    assert rows[0] == ("dropped on reading: not finite", 80)
    places = [[name for name, _ in rows].index(name) for name in LEFT]
    for first, last in pairwise(places):
        assert rows[first][1] == sum(n for _, n in rows[first + 1 : last + 1])
