"""The demo's figure, what changes on it, and its campaign through the front door."""

import json

import numpy as np
import pytest
import trimesh

from monitor.simulation import write_demo_campaign
from monitor.simulation.demo_campaign import EXTENT, SIGMA_POSITION
from monitor.simulation.figure import carved_figure, figure_field, lost_corner, motion, spall, true_changes, worn_patch
from monitor.simulation.solid import evaluate, gradient
from projects.extent import inside, read_extent
from projects.formats import read_scans
from projects.transforms import apply, invert


@pytest.fixture(scope="module")
def figure():
    """Return the first epoch's figure with coarse triangles."""
    return carved_figure(1, cell=0.006)


def test_the_figure_is_closed_and_its_vertices_are_its_surface(figure):
    mesh = trimesh.Trimesh(figure.body.vertices, figure.body.faces, process=False)
    there, back = (np.unique(mesh.edges @ order, return_counts=True) for order in ([10**6, 1], [1, 10**6]))
    np.testing.assert_array_equal(there, back)  # closed: each edge is passed as often one way as the other
    assert 0.02 < mesh.volume < 0.2
    assert 1.5 < np.ptp(figure.body.vertices[:, 2]) < 1.75
    # At creases, frequent at this coarse spacing, no step along a gradient reaches the surface.
    assert np.quantile(np.abs(evaluate(figure.field, figure.body.vertices)), 0.9) < 2e-6


def test_the_truth_knows_a_point_held_off_the_surface(figure, rng):
    at = figure.body.vertices[rng.choice(len(figure.body.vertices), 1000, replace=False)]
    n = gradient(figure.field, at)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    for height in (0.0005, -0.0005):
        found = figure.truth.signed_distance(at + height * n)
        # Nearer than its foot only where the surface bends sharply or another part is close.
        assert np.mean(np.abs(found - height) < 5e-6) > 0.6
        assert np.quantile(np.abs(found), 0.95) < abs(height) + 5e-6


def test_nothing_changes_outside_of_the_boxes_of_the_changes(figure):
    vertices = figure.body.vertices
    moved = np.abs(evaluate(figure_field(2), vertices) - evaluate(figure_field(1), vertices)) > 1e-9
    boxes = [edit.box for edit in (lost_corner(), spall(), worn_patch())]
    held = [((vertices >= b[0]) & (vertices <= b[1])).all(axis=1) for b in boxes]
    assert not moved[~np.any(held, axis=0)].any()
    assert all(moved[h].any() for h in held)


def test_the_changes_have_the_sizes_that_are_told(rng):
    corner, filled, worn = true_changes()
    assert (corner.kind, filled.kind, worn.kind) == ("lost", "added", "lost")
    assert -0.035 < corner.extreme < -0.015
    assert 0.007 < filled.extreme < 0.010
    assert worn.extreme == pytest.approx(-0.0022 / 0.75, rel=0.1)  # the robe's field is 0.75 as steep as a distance
    for change in (corner, filled, worn):  # volumes against a count of random points
        points = rng.uniform(*change.box, (400_000, 3))
        gained = (evaluate(figure_field(2), points) < 0).astype(int) - (evaluate(figure_field(1), points) < 0)
        volume = np.prod(np.ptp(change.box, axis=0))
        sigma = volume * gained.std() / np.sqrt(len(points))
        assert abs(volume * gained.mean() - change.volume) < 4 * sigma + 0.01 * abs(change.volume)


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """Return a campaign with wide spacing and coarse triangles."""
    return write_demo_campaign(tmp_path_factory.mktemp("demo"), seed=7, cell=0.006, spacing=0.008)


@pytest.mark.slow
def test_the_campaign_comes_back_through_the_reader_as_it_was_measured(campaign, figure):
    extent = read_extent(campaign.extent)
    np.testing.assert_array_equal(extent.corners.min(axis=0), EXTENT[0, :2])
    scans = [chunk for stream in read_scans(campaign.epochs[0]) for chunk in stream.chunks()]
    assert len({scan.name for scan in scans}) == 6
    points = np.concatenate([apply(scan.pose, scan.cloud.points) for scan in scans])
    kept = points[inside(extent, points)]
    assert len(kept) > 20_000
    distance = figure.truth.signed_distance(kept[::3])
    # Noise 0.15 mm and up, registration 0.2 mm, and the floor of what 6 mm triangles show of 3 mm folds.
    assert abs(np.median(distance)) < SIGMA_POSITION
    assert 1.4826 * np.median(np.abs(distance - np.median(distance))) < 0.0006


@pytest.mark.slow
def test_the_second_epoch_is_moved_by_the_stated_motion(campaign, figure):
    scans = [chunk for stream in read_scans(campaign.epochs[1]) for chunk in stream.chunks()]
    points = np.concatenate([apply(scan.pose, scan.cloud.points) for scan in scans])
    points = points[(points[:, 2] > 0.06) & (points[:, 2] < 0.37) & (np.abs(points[:, :2]).max(axis=1) < 0.25)]
    back = apply(invert(motion()), points)
    still, moved = (np.median(np.abs(figure.truth.signed_distance(p[::3]))) for p in (points, back))
    assert moved < 0.0004
    assert still > 0.0009


@pytest.mark.slow
def test_the_truth_is_written_beside_the_scans(campaign):
    truth = json.loads((campaign.extent.parent / "truth.json").read_text())
    np.testing.assert_allclose(truth["T_second_first"], motion())
    assert [c["kind"] for c in truth["changes"]] == ["lost", "added", "lost"]
    assert all(c["area_m2"] > 0 for c in truth["changes"])
