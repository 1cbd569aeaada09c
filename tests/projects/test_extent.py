"""Box and polygon extents: what is inside, and what is said about bad files."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from projects.errors import FormatError, ParameterError
from projects.extent import Extent, _crosses_itself, _side, inside, read_extent

L_SHAPE = {"polygon": [[0, 0], [2, 0], [2, 1], [1, 1], [1, 3], [0, 3]], "bottom": 0.5, "top": 2}


def write(folder, content):
    path = folder / "extent.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
    return path


def test_box_holds_its_border_and_nothing_beyond(tmp_path):
    extent = read_extent(write(tmp_path, {"box": {"min": [0, -1, 2], "max": [1, 1, 3]}}))
    points = np.array([[0, -1, 2], [1, 1, 3], [0.5, 0, 2.5], [1.0001, 0, 2.5], [0.5, 0, 1.999], [math.nan, 0, 2.5]])
    assert inside(extent, points).tolist() == [True, True, True, False, False, False]


def test_unit_turns_millimetres_of_the_file_into_metres(tmp_path):
    path = write(tmp_path, {"polygon": [[0, 0], [1000, 0], [0, 1000]], "top": 500})
    extent = read_extent(path, unit=0.001)
    points = np.array([[0.3, 0.3, 0.49], [0.3, 0.3, 0.51], [0.6, 0.6, 0.0], [3.0, 3.0, 0.0]])
    assert inside(extent, points).tolist() == [True, False, False, False]


def test_reentrant_polygon_leaves_out_its_notch():
    points = np.array([[0.5, 2.5, 1], [1.5, 0.5, 1], [1.5, 2.0, 1], [0.5, 0.5, 0.4], [0.5, 0.5, 2.1]])
    assert inside(L_SHAPE, points).tolist() == [True, True, False, False, False]


def test_polygon_agrees_with_the_winding_number_of_random_points(rng):
    corners = np.array(L_SHAPE["polygon"], dtype=float)
    points = np.column_stack([rng.uniform(-1, 4, (4000, 2)), np.ones(4000)])
    to_corner = corners[None] - points[:, None, :2]
    angles = np.arctan2(to_corner[..., 1], to_corner[..., 0])
    turns = (np.diff(angles, axis=1, append=angles[:, :1]) + np.pi) % (2 * np.pi) - np.pi
    assert (inside(L_SHAPE, points) == (np.abs(turns.sum(axis=1)) > np.pi)).all()


def test_direction_and_closing_corner_make_no_difference(rng):
    points = np.column_stack([rng.uniform(-1, 4, (500, 2)), np.ones(500)])
    corners = L_SHAPE["polygon"]
    other = {**L_SHAPE, "polygon": [*corners, corners[0]][::-1]}
    assert (inside(L_SHAPE, points) == inside(other, points)).all()


def test_far_coordinates_keep_their_millimetres():
    far = np.array([2.6e6, 5.6e6])
    extent = {"polygon": (np.array([[0, 0], [1, 0], [0.5, 1]]) + far).tolist()}
    near = np.array([[0.5, 0.999, 0], [0.5, 1.001, 0], [0.002, 0.001, 0], [0.0, 0.002, 0]])
    points = near + np.append(far, 0)
    assert inside(extent, points).tolist() == [True, False, True, False]


def test_extent_survives_its_mapping(rng):
    points = rng.uniform(-1, 4, (500, 3))
    for mapping in (L_SHAPE, {"box": {"min": [0, 0, 0], "max": [1, 2, 3]}}, {"polygon": [[0, 0], [2, 0], [0, 2]]}):
        kept = json.loads(json.dumps(Extent.from_mapping(mapping).to_mapping()))
        assert (inside(kept, points) == inside(mapping, points)).all()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{not json", "is not JSON"),
        ("[1, 2]", "an extent is"),
        ({}, "an extent is"),
        ({"box": {"min": [0, 0], "max": [1, 1, 1]}}, "box/min: 3 numbers needed"),
        ({"box": {"min": [0, 0, 0], "max": [1, 0, 1]}}, "is not below its max"),
        ({"box": {"min": [0, 0, "x"], "max": [1, 0, 1]}}, "box/min: 3 numbers needed"),
        ('{"box": {"min": [0, 0, NaN], "max": [1, 1, 1]}}', "is not finite"),
        ({"polygon": [[0, 0], [1, 1]]}, "at least three corners"),
        ({"polygon": [[0, 0], [1, 1], [2, 2]]}, "encloses no area"),
        ({"polygon": [[0, 0], [3, 1], [1, 0], [0, 1]]}, "crosses itself"),
        ({"polygon": [[0, 0], [1, 0], [0, 1]], "bottom": 2, "top": 1}, "is not below the top"),
        ({"polygon": [[0, 0], [1, 0], [0, 1]], "bottm": 2}, "unknown entry 'bottm'"),
    ],
)
def test_bad_extents_are_refused_in_one_clear_line(tmp_path, content, message):
    with pytest.raises(FormatError, match=message) as caught:
        read_extent(write(tmp_path, content))
    assert "\n" not in str(caught.value)
    assert "extent.json" in str(caught.value)


def test_missing_extent_file_is_named(tmp_path):
    with pytest.raises(FormatError, match=r"nothing\.json cannot be read"):
        read_extent(tmp_path / "nothing.json")


def crosses_pair_by_pair(corners):
    """Return whether two edges that are not neighbours cross, asked of each pair by itself."""

    def side(a, b, p):
        return np.sign((b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]))

    n = len(corners)
    edges = [(corners[k], corners[(k + 1) % n]) for k in range(n)]
    pairs = [(edges[i], edges[j]) for i in range(n) for j in range(i + 2, n) if (j + 1) % n != i]
    return any(side(a, b, c) * side(a, b, d) < 0 and side(c, d, a) * side(c, d, b) < 0 for (a, b), (c, d) in pairs)


def test_polygons_that_cross_themselves_are_those_of_which_a_pair_of_edges_crosses(rng):
    found = []
    for k in range(300):
        n = 4 + k % 9
        angles = np.sort(rng.uniform(0, 2 * np.pi, n))
        corners = rng.uniform(0.3, 1.0, (n, 1)) * np.c_[np.cos(angles), np.sin(angles)]
        corners = np.round(corners, 1) if k % 3 == 0 else corners  # edges along x and y, and corners on edges
        if k % 2:
            i, j = rng.integers(0, n, 2)
            corners[[i, j]] = corners[[j, i]]
        found.append(_crosses_itself(corners))
        assert found[-1] == crosses_pair_by_pair(corners), corners.tolist()
    assert 50 < sum(found) < 250


def test_an_outline_of_many_corners_is_read_at_once():
    """Asked of each pair of its edges, it took minutes."""
    angles = np.linspace(0.0, 2.0 * np.pi, 60_000, endpoint=False)
    outline = np.c_[np.cos(angles), np.sin(angles)]
    assert len(Extent.from_mapping({"polygon": outline.tolist()}).corners) == 60_000
    outline[[100, 40_000]] = outline[[40_000, 100]]
    with pytest.raises(ParameterError, match="crosses itself"):
        Extent.from_mapping({"polygon": outline.tolist()})


def comb(n_teeth, angle):
    """Return the corners of a comb with long teeth, turned by an angle."""
    at = np.arange(2 * n_teeth) / n_teeth
    teeth = np.c_[at, 0.1 + 5.0 * (np.arange(2 * n_teeth) % 2)]
    corners = np.concatenate([teeth, [[2.0, 0.0], [0.0, 0.0]]])
    c, s = np.cos(angle), np.sin(angle)
    return corners @ np.array([[c, s], [-s, c]]) + [2.6e6, 5.6e6]


@pytest.mark.parametrize("angle", [0.0, 0.05, 0.7, np.pi / 2])
def test_of_a_comb_few_pairs_of_edges_are_asked_whichever_way_its_teeth_stand(angle, monkeypatch):
    """Asked of all that lie beside each other along x, a comb of 20 000 corners took half a minute."""
    asked = []

    def counted(a, b, p):
        asked.append(max(np.size(a), np.size(p)) // 2)
        return _side(a, b, p)

    monkeypatch.setattr("projects.extent._side", counted)
    corners = comb(10_000, angle)
    assert not _crosses_itself(corners)
    assert sum(asked) < 20 * len(corners)
    corners[[501, 503]] = corners[[503, 501]]
    assert _crosses_itself(corners)


def test_combs_and_stars_cross_themselves_where_a_pair_of_edges_does(rng):
    found = []
    for k in range(60):
        n = int(rng.integers(6, 20))
        turn = 2.0 * np.pi * np.arange(2 * n) / (2 * n)
        star = np.c_[np.cos(turn), np.sin(turn)] * np.where(np.arange(2 * n) % 2, 1.0, 0.01)[:, None]
        corners = comb(n, rng.uniform(0.0, np.pi)) if k % 2 else star
        if k % 4 > 1:
            i, j = rng.integers(0, len(corners), 2)
            corners[[i, j]] = corners[[j, i]]
        found.append(_crosses_itself(corners))
        assert found[-1] == crosses_pair_by_pair(corners), corners.tolist()
    assert 15 < sum(found) < 45


def test_corners_on_a_grid_that_touch_without_crossing_are_told_as_pair_by_pair(rng):
    found = []
    for _ in range(400):
        corners = rng.integers(0, 4, (int(rng.integers(3, 7)), 2)).astype(float)
        found.append(_crosses_itself(corners))
        assert found[-1] == crosses_pair_by_pair(corners), corners.tolist()
    assert 50 < sum(found) < 350
