"""Stations around an object, and campaigns of any scene through the front door."""

import datetime
import json

import numpy as np
import pytest

from monitor.simulation import (
    INSTRUMENTS,
    Model,
    SurveyedEpoch,
    attic_stations,
    box_part,
    build_scene,
    move_whole,
    register_with_errors,
    stand_around,
    stove_stations,
    write_campaign,
)
from projects.errors import ParameterError
from projects.formats import read_scans
from projects.transforms import apply, invert

BOX = np.array([[-0.25, -0.25, 0.0], [0.25, 0.25, 0.5]])
LIFTED = np.array([[1.0, 0, 0, 0.002], [0, 1, 0, 0.003], [0, 0, 1, 0.003], [0, 0, 0, 1]])


@pytest.mark.parametrize("format", ["e57", "ptx"])
def test_a_campaign_comes_back_through_the_reader_from_where_its_scenes_stood(tmp_path, format):
    model = Model("block", (box_part("block", [-0.2, -0.2, 0.1], [0.2, 0.2, 0.4], cell=0.02),))
    stations = register_with_errors(stand_around([(-90, 2.0, 0.6), (30, 2.0, 0.3)], spacing=0.01), seed=5)
    scenes = build_scene(model), build_scene(model, [move_whole("lifted", LIFTED)])
    epochs = [SurveyedEpoch(s, stations, datetime.date(2025 + k, 5, 1)) for k, s in enumerate(scenes)]
    campaign = write_campaign(tmp_path / "survey", epochs, INSTRUMENTS["phase-2020"], box=BOX, format=format)
    assert [p.name for p in campaign.epochs] == [f"epoch-1.{format}", f"epoch-2.{format}"]
    assert json.loads(campaign.extent.read_text()) == {"box": {"min": BOX[0].tolist(), "max": BOX[1].tolist()}}
    for k, path in enumerate(campaign.epochs):
        scans = [chunk for stream in read_scans(path) for chunk in stream.chunks()]
        assert len(scans) == 2
        for scan, station in zip(scans, stations, strict=True):
            np.testing.assert_allclose(scan.pose, station.registered, atol=1e-6)
            points = apply(station.T_project_scanner, scan.cloud.points)
            found, other = (np.median(np.abs(s.truth.signed_distance(points))) for s in (scenes[k], scenes[1 - k]))
            assert found < 0.0003 < other  # range noise 0.15 mm and up against the motion by 2 mm and 3 mm


def test_the_stations_of_the_papers_objects_stand_as_told():
    stove, attic = stove_stations(), attic_stations()
    assert (len(stove), len(attic)) == (3, 8)
    heights = np.array([s.T_project_scanner[2, 3] for s in attic])
    assert len(np.unique(heights)) == 2  # from two height levels
    for stations, spacing in ((stove, 0.0007), (attic, 0.002)):
        for s in stations:
            distance = np.hypot(*s.T_project_scanner[:2, 3])
            assert distance < 5.0
            assert s.step * distance == pytest.approx(spacing, rel=0.12)
            axis = apply(invert(s.T_project_scanner), np.array([[0.0, 0.0, s.T_project_scanner[2, 3]]]))[0]
            np.testing.assert_allclose(axis, [distance, 0.0, 0.0], atol=1e-9)  # the x axis points at the object
    assert stove_stations(spacing=0.007)[0].step == pytest.approx(10 * stove[0].step)


def test_a_format_that_no_campaign_has_is_refused(tmp_path):
    with pytest.raises(ParameterError, match="written as e57 or ptx"):
        write_campaign(tmp_path, [], INSTRUMENTS["phase-2020"], box=BOX, format="las")
