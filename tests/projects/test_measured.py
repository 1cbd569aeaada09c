"""What is no measurement is dropped and counted by reason; what is left keeps its order and its columns."""

import numpy as np
import pytest

from projects.errors import FormatError
from projects.formats.measured import keep_measurements


def kept(blocks, is_centred=False):
    """Return points, intensity and the sum of the counts."""
    out = list(keep_measurements(blocks, is_centred))
    total = {}
    for _, dropped in out:
        for reason, n in dropped.items():
            total[reason] = total.get(reason, 0) + n
    return np.concatenate([columns["points"] for columns, _ in out]), [columns for columns, _ in out], total


def test_every_reason_is_counted_once_for_each_point():
    points = np.array([[1, 1, 1], [np.nan, 0, 0], [0, 0, np.inf], [0, 0, 0], [2, 2, 2], [1e300, 0, 0], [3, 3, 3.0]])
    invalid = np.array([False, True, False, False, True, False, False])
    got, _, total = kept([{"points": points, "invalid": invalid}], is_centred=True)
    assert got.tolist() == [[1, 1, 1], [3, 3, 3]]
    assert total == {"not finite": 3, "flagged invalid": 1, "no return": 1}


def test_lone_point_at_the_origin_is_a_measurement_where_the_scanner_is_elsewhere():
    blocks = [{"points": np.array([[1.0, 1, 1], [0, 0, 0]]), "intensity": np.array([0.1, 0.2])},
              {"points": np.array([[2.0, 2, 2]]), "intensity": np.array([0.3])}]  # fmt: skip
    got, columns, total = kept(blocks)
    assert got.tolist() == [[1, 1, 1], [2, 2, 2], [0, 0, 0]]
    assert columns[0]["intensity"].tolist() == [0.1, 0.3, 0.2]
    assert total == {}


def test_several_points_at_exactly_the_origin_are_none():
    got, _, total = kept(
        [{"points": np.array([[0.0, 0, 0], [1, 1, 1]])}, {"points": np.array([[2.0, 2, 2], [0, 0, 0]])}]
    )
    assert got.tolist() == [[1, 1, 1], [2, 2, 2]]
    assert total == {"at exactly 0 0 0": 2}


def test_counts_after_the_last_point_are_not_lost_and_no_chunk_is_empty():
    out = list(
        keep_measurements([{"points": np.array([[1.0, 1, 1], [2, 2, 2]])}, {"points": np.full((7, 3), np.nan)}], True)
    )
    assert [(len(columns["points"]), dropped) for columns, dropped in out] == [(2, {"not finite": 7})]


@pytest.mark.parametrize(
    ("blocks", "message"),
    [
        ([], "holds no points"),
        ([{"points": np.empty((0, 3))}], "holds no points"),
        ([{"points": np.full((3, 3), np.nan)}], r"none of its 3 points is a measurement \(not finite: 3\)"),
        ([{"points": np.ones((3, 3))}], "all its 3 points lie at one place"),
    ],
)
def test_scan_without_measurements_is_an_error(blocks, message):
    with pytest.raises(FormatError, match=message):
        list(keep_measurements(blocks, False))
