"""What changed beside a layer all over: found as if there were none, and told with it."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import trimesh
from layered_body import make_body

from monitor.comparison import compare
from monitor.comparison.regions.beside_layer import level_with, name_beside, outward, peel, peel_points
from projects.model import Assessment, Comparison, Floats, Surface

WIDTH, DEPTH = 0.08, 0.003  # m, of the dent


def press(body: Surface, depth: float) -> tuple[Surface, Floats]:
    """Return a body with a cosine bowl `depth` (m) deep pressed in, and how far each vertex went in (n,), m."""
    mesh = trimesh.Trimesh(body.vertices, body.faces, process=False)
    way = body.vertices / np.linalg.norm(body.vertices, axis=1)[:, None]
    middle = body.vertices[np.argmax(way @ [1.0, 0.2, 0.3])]
    away = np.linalg.norm(body.vertices - middle, axis=1)
    lost = np.where(away < WIDTH / 2, 0.5 * depth * (1.0 + np.cos(2.0 * np.pi * away / WIDTH)), 0.0)
    return replace(body, vertices=body.vertices - lost[:, None] * mesh.vertex_normals), lost


def compare_dented(rng: np.random.Generator, layer: float, depth: float) -> tuple[Comparison, Floats]:
    """Return a body against itself with a layer (m) less and a dent, and what the dent took of each vertex, m."""
    before = make_body(rng, 0.0, 0.0, -2.0)
    after, lost = press(make_body(rng, 0.7, layer, -2.0), depth)
    return compare(before, after), lost


@pytest.mark.parametrize("layer", [0.0, 0.001, -0.0006])
def test_a_dent_is_found_beside_a_layer_as_without_one(rng: np.random.Generator, layer: float) -> None:
    """The layer was taken for an error of all: a dent of 3 mm and 30 cm2 was hidden by a level of 1.2 mm."""
    found, lost = compare_dented(rng, layer, DEPTH)
    assert list(found.regions["kind"]) == ["lost"]
    dent = found.regions.iloc[0]
    side = found.on_compared
    mesh = trimesh.Trimesh(side.surface.vertices, side.surface.faces, process=False)
    areas = np.bincount(mesh.faces.ravel(), np.repeat(mesh.area_faces / 3.0, 3), len(lost))
    assert dent.volume_m3 == pytest.approx(-areas @ lost, abs=7e-7)
    assert dent.sigma_volume_m3 < 1.3e-6
    assert dent.extreme_m == pytest.approx(-DEPTH, abs=3e-4)
    assert dent.area_m2 == pytest.approx(areas[lost > 3e-4].sum(), rel=0.15)


@pytest.mark.parametrize("layer", [0.001, -0.0006])
def test_distances_and_levels_hold_with_the_layer(rng: np.random.Generator, layer: float) -> None:
    found, lost = compare_dented(rng, layer, DEPTH)
    beside = found.statistics["lod95_beside_layer_median_m"]
    assert beside < 4e-4
    one_sided = 1.6449 / 1.96 * beside  # errors of a third of the layer: the size of none is beyond on the other side
    assert found.statistics["lod95_median_m"] == pytest.approx(one_sided + abs(found.registration.layer), abs=1e-7)
    for side in (found.on_compared, found.on_reference):
        assert (side.assessment == Assessment.CHANGED).any()
        assert side.told_from is not None
    told = found.statistics["told_by_width_m"][0][1] + abs(found.registration.layer)  # against the rest, and the layer
    assert found.statistics["told_from_median_m"] == pytest.approx(told, rel=0.02)
    for side in (found.on_compared, found.on_reference):
        unchanged = side.distances[side.assessment == Assessment.UNCHANGED]
        assert np.median(unchanged) == pytest.approx(-layer, abs=1e-4)
    deepest = found.on_compared.distances[lost > 2.9e-3]
    assert np.median(deepest) == pytest.approx(-0.00295 - layer, abs=2e-4)
    assert found.statistics["offset_m"] == pytest.approx(-layer, abs=1e-4)


@pytest.mark.parametrize("layer", [0.0, -0.0001, 0.0003, 0.001, -0.002])
def test_the_level_with_a_layer_holds_for_distances_with_it(rng: np.random.Generator, layer: float) -> None:
    sigma = rng.choice([1e-4, 2e-4, 4e-4], 400_000)
    level = level_with(1.959964 * sigma, layer)
    beyond = np.abs(rng.normal(layer, sigma)) > level
    for own in np.unique(sigma):
        assert np.mean(beyond[sigma == own]) == pytest.approx(0.05, abs=0.002)


def test_nothing_stands_out_of_a_layer_alone(rng: np.random.Generator) -> None:
    found, _ = compare_dented(rng, 0.001, 0.0)
    assert not len(found.regions)
    assert not (found.on_compared.assessment == Assessment.CHANGED).any()


def test_what_a_cleaning_left_out_is_neither_lost_nor_added(rng: np.random.Generator) -> None:
    """It stands 2 mm out of what was cleaned by 2 mm, and lies where it lay."""
    found, lost = compare_dented(rng, 0.002, -0.002)
    assert list(found.regions["kind"]) == ["unclear"]
    assert found.regions["extreme_m"][0] == pytest.approx(0.002, abs=3e-4)
    assert abs(np.median(found.on_compared.distances[lost < -1.9e-3])) < 3e-4


def test_peeling_moves_faces_and_not_vertices_by_the_thickness() -> None:
    cube = trimesh.creation.box((0.2, 0.2, 0.2)).subdivide().subdivide()
    peeled = peel(Surface(cube.vertices, cube.faces), 0.001)
    on_edges = np.sum(np.abs(cube.vertices) > 0.0999, axis=1)
    flat = np.abs(peeled.vertices[on_edges == 1]).max(axis=1)
    np.testing.assert_allclose(flat, 0.099, atol=1e-9)
    edge = np.sort(np.abs(peeled.vertices[on_edges == 2]), axis=1)[:, 1:]
    np.testing.assert_allclose(edge, 0.099, atol=1e-9)  # and not 0.1 - 0.001 * sqrt(0.5)
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    surface = Surface(ball.vertices, ball.faces)
    np.testing.assert_allclose(np.linalg.norm(peel(surface, -0.001).vertices, axis=1), 0.101, atol=1e-5)
    alone = Surface(np.vstack([ball.vertices, [[1.0, 1.0, 1.0]]]), ball.faces)
    assert not outward(alone)[-1].any()
    points = 1.01 * ball.triangles_center
    moved = peel_points(points, surface, 0.002)
    assert moved is not None
    np.testing.assert_allclose(
        np.linalg.norm(moved, axis=1), np.linalg.norm(points, axis=1) - 0.002, atol=2e-5
    )  # their vertices' normals differ from their own ways by a few degrees
    assert peel_points(None, surface, 0.002) is None


@pytest.mark.parametrize(
    ("mean", "layer", "kind"),
    [(-0.002, 0.001, "lost"), (-0.001, 0.002, "unclear"), (0.001, -0.001, "unclear"), (0.003, -0.001, "lost")],
)
def test_the_layer_decides_no_kind(mean: float, layer: float, kind: str) -> None:
    assert name_beside(pd.DataFrame({"mean_m": [mean], "kind": ["lost"]}), layer)["kind"][0] == kind
