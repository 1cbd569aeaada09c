"""The tables of a survey in an archive: what they say of files, clouds and meshes."""

from dataclasses import replace

import numpy as np
from example_project import measured, step
from report_examples import example_epochs, example_object

from projects import Surface
from reports.survey_tables import cloud_rows, mesh_rows, survey_rows


def test_the_unit_of_the_original_files_stands_beside_that_of_the_archive() -> None:
    first, _ = example_epochs()
    for unit, word in ((0.0254, "inch"), (0.01, "centimetre"), (0.1, "0.1 m"), (None, "not recorded")):
        epoch = replace(first, record=replace(first.record, unit=unit))
        rows = {field: value for _, field, value in survey_rows(("", "", ""), example_object(), epoch, [])}
        assert rows["Unit of coordinates"] == "metre"
        assert rows["Unit of the numbers in the original files"] == word


def test_what_is_smoothed_or_filled_is_said_to_be() -> None:
    epoch = example_epochs()[0]
    asked = {"filter": {"thinning": {"method": "voxel_median"}, "diffusion": {"enabled": True}}}
    told = {field: value for _, field, value in cloud_rows(measured(0), step("filtered", "2", parameters=asked), epoch)}
    assert told["Smoothing"] == "yes: anisotropic diffusion"
    assert "median of a voxel" in told["Subsampling"]
    plain = {field: value for _, field, value in cloud_rows(measured(0), step("filtered", "2"), epoch)}
    assert plain["Smoothing"] == "no"
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    closed = Surface(corners, np.array([[0, 1, 2], [1, 3, 2]]), face_invented=np.array([False, True]))
    filled = {f: v for _, f, v in mesh_rows(closed, step("surface", "3", automatic={"method": "localized"}))}
    assert filled["Holes filled"] == "yes: 1 triangles, marked"
    assert filled["Sigma of a vertex, median [m]"] == "not recorded"
