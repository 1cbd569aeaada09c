"""The nouns take arrays of numbers as they are, and refuse by name what would not be the same numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from projects.convert import surface_from_pyvista, surface_to_pyvista
from projects.errors import ParameterError, ShapeError
from projects.model import PointCloud, Surface

CORNERS = np.eye(3)


@pytest.mark.parametrize(("what", "given"), [
    ("points is not an array of numbers", {"points": "abc"}),
    ("points is not an array of numbers", {"points": [[1, 2], [3]]}),
    ("points is not an array of numbers", {"points": CORNERS + 1j}),
    ("points is None", {"points": None}),
    ("points is not an array of numbers", {"points": [[None, 1, 2]]}),
    ("points is masked in 3 places; fill unknown values with NaN", {"points": np.ma.masked_equal(CORNERS + 7.0, 8.0)}),
    (r"colors holds other than whole numbers from 0 to 255", {"points": CORNERS, "colors": 0.5 * np.ones((3, 3))}),
    (r"colors holds other than whole numbers from 0 to 255", {"points": CORNERS, "colors": 300.0 * np.ones((3, 3))}),
    (r"colors holds other than whole numbers from 0 to 255", {"points": CORNERS, "colors": -np.ones((3, 3), int)}),
    (r"points has shape \(3,\); \(n, 3\) is needed", {"points": np.ones(3)}),
])  # fmt: skip
def test_what_is_no_cloud_is_refused(what: str, given: dict[str, Any]) -> None:
    with pytest.raises(ShapeError, match=what):
        PointCloud(**given)


@pytest.mark.parametrize("faces", [[[0, 1, np.nan]], [[0, 1, 2**40]], [[0, 1, 1.5]]])
def test_faces_are_whole_numbers(faces: Any) -> None:
    with pytest.raises(ShapeError, match="faces holds other than whole numbers"):
        Surface(CORNERS, faces)


def test_numbers_of_other_kinds_are_taken_where_they_are_the_same() -> None:
    cloud = PointCloud(CORNERS.astype(np.float32), colors=255.0 * np.ones((3, 3)), scan_index=[0, 1, 2])
    assert (cloud.points.dtype, cloud.colors.dtype, cloud.scan_index.dtype) == (np.float64, np.uint8, np.int32)
    assert (cloud.colors == 255).all()
    assert Surface(CORNERS, [[0.0, 1.0, 2.0]]).faces.tolist() == [[0, 1, 2]]
    assert len(PointCloud(np.empty((0, 3)), colors=np.empty((0, 3)))) == 0


def test_an_empty_surface_goes_to_pyvista_and_back() -> None:
    empty = surface_from_pyvista(surface_to_pyvista(Surface(np.empty((0, 3)), np.empty((0, 3), int))))
    assert empty.vertices.shape == empty.faces.shape == (0, 3)


@pytest.mark.parametrize("name", ["sigma", "spread"])
def test_a_standard_deviation_below_zero_is_refused_and_an_unknown_one_is_not(name: str) -> None:
    with pytest.raises(ParameterError, match=f"{name} holds -0.001 m; a standard deviation is 0 or more"):
        PointCloud(CORNERS, **{name: [0.1, -0.001, np.nan]})
    assert np.isnan(getattr(PointCloud(CORNERS, **{name: [0.1, 0.0, np.nan]}), name)[2])
