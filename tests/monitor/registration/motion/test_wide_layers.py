"""A layer taken off a large part of an object: neither shared out by the motion nor taken for the noise of all."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from layered_body import SHARED, area_above, make_body

from monitor.apart import stand_apart
from monitor.comparison import compare
from monitor.registration import register
from projects.model import Floats, PointCloud, Registration, Surface
from projects.transforms import apply


@pytest.mark.parametrize(("layer", "above"), [(0.0, 1 / 3), (0.0008, 1 / 3), (0.0015, 1 / 3), (0.0015, 0.2)])
def test_a_layer_taken_off_a_large_part_moves_nothing(rng: np.random.Generator, layer: float, above: float) -> None:
    """The motion took half of 0.8 mm off a third, and everything was held to be stable."""
    before, after = make_body(rng, 0.0, 0.0, above), make_body(rng, 0.7, layer, above)
    found = register(after, before)
    assert found.converged
    way = apply(found.T_target_source, before.vertices) - before.vertices
    assert np.sqrt(np.mean(np.sum(way**2, axis=1))) < 1.5e-4
    share = 1.0 - area_above(after, above) if layer else 1.0
    assert found.stable_share == pytest.approx(share, abs=0.06)


def open_below(body: Surface) -> Surface:
    """Return a body without its lower quarter, which no station saw."""
    kept = body.vertices[:, 2] > -0.06
    number = np.cumsum(kept) - 1
    faces = number[body.faces[kept[body.faces].all(axis=1)]].astype(np.int32)
    return Surface(body.vertices[kept], faces, sigma=body.sigma[kept], sigma_shared=body.sigma_shared[kept])


@pytest.mark.parametrize("layer", [0.001, -0.0006])
def test_a_layer_all_over_is_a_parameter_of_its_own(rng: np.random.Generator, layer: float) -> None:
    """A body on a pedestal, open below, was 1.5 times the layer off, stated a quarter of it; of coatings undoubted."""
    before, after = (open_below(make_body(rng, 0.7 * k, layer * k, -2.0)) for k in range(2))
    found = register(after, before)
    assert found.converged
    assert not found.doubt
    assert found.layer == pytest.approx(-layer, abs=5e-5)
    assert found.sigma_layer == pytest.approx(np.sqrt(2.0) * SHARED, rel=0.1)
    way = apply(found.T_target_source, before.vertices) - before.vertices
    assert np.sqrt(np.mean(np.sum(way**2, axis=1))) < 2.5e-4
    assert found.stable_share > 0.9


@pytest.mark.parametrize(("layer", "above"), [(0.0, 0.0), (0.0008, 1 / 3), (0.0015, 0.0)])
def test_what_is_no_layer_all_over_is_told_as_none(rng: np.random.Generator, layer: float, above: float) -> None:
    before, after = make_body(rng, 0.0, 0.0, above), make_body(rng, 0.7, layer, above)
    found = register(after, before)
    assert np.isnan(found.layer)
    assert np.isnan(found.sigma_layer)


def test_where_normals_look_either_way_no_layer_is_told(rng: np.random.Generator) -> None:
    """Peeled off along normals that look inward it would be laid on."""
    before, after = (open_below(make_body(rng, 0.7 * k, 0.001 * k, -2.0)) for k in range(2))
    clouds = [PointCloud(b.vertices, sigma=np.full(len(b.vertices), SHARED)) for b in (before, after)]
    assert np.isnan(register(clouds[1], clouds[0]).layer)


@pytest.mark.parametrize("seed", [1, 3])
def test_a_layer_on_half_of_it_is_none_all_over_or_doubted(seed: int) -> None:
    rng = np.random.default_rng(seed)
    before, after = make_body(rng, 0.0, 0.0, 0.0), make_body(rng, 0.7, 0.001, 0.0)
    found = register(after, before)
    assert np.isnan(found.layer) or "on a part of them alone" in found.doubt


def test_a_layer_taken_off_nearly_half_is_one_region_and_half_and_half_is_refused(rng: np.random.Generator) -> None:
    """Of nearly half none was found, of half the motion was a compromise 1.1 to 2 mm off."""
    before, after = make_body(rng, 0.0, 0.0, 0.1), make_body(rng, 0.7, 0.0015, 0.1)
    result = compare(before, after)
    assert list(result.regions["kind"]) == ["cleaned"]
    assert result.regions["mean_m"][0] == pytest.approx(-0.0015, abs=1e-4)
    area = trimesh.Trimesh(after.vertices, after.faces, process=False).area * area_above(after, 0.1)
    assert result.regions["area_m2"][0] == pytest.approx(area, rel=0.08)
    half = register(make_body(rng, 0.7, 0.0015, 0.0), before)
    assert not half.converged
    assert "none is the majority's" in half.reason


def test_where_the_stable_area_that_someone_knows_tells_nothing_the_noise_is_learned_as_ever(
    rng: np.random.Generator,
) -> None:
    before, after = make_body(rng, 0.0, 0.0, 1 / 3), make_body(rng, 0.7, 0.001, 1 / 3)
    nothing = replace(register(after, before), is_stable=None)
    known, unknown = (compare(before, after, nothing, stable_is_given=given) for given in (True, False))
    np.testing.assert_array_equal(known.on_compared.lod95, unknown.on_compared.lod95)
    assert len(known.regions) == len(unknown.regions)


def test_a_layer_taken_off_a_third_is_one_region_and_not_the_level_of_all(rng: np.random.Generator) -> None:
    """No region was found and the level was 1 mm, since the layer taught it; the wide noise then hid the layer."""
    before, after = make_body(rng, 0.0, 0.0, 1 / 3), make_body(rng, 0.7, 0.001, 1 / 3)
    result = compare(before, after)
    assert len(result.regions) == 1
    region = result.regions.iloc[0]
    assert region["kind"] == "cleaned"
    assert region["mean_m"] == pytest.approx(-0.001, abs=1e-4)
    area = trimesh.Trimesh(after.vertices, after.faces, process=False).area * area_above(after, 1 / 3)
    assert region["area_m2"] == pytest.approx(area, rel=0.05)
    assert result.statistics["lod95_median_m"] < 4e-4


def test_a_layer_taken_off_all_but_a_base_is_found_where_someone_knows_that_the_base_did_not_change(
    rng: np.random.Generator,
) -> None:
    """Found by itself the level was 0.57 mm for a layer of 1.2 mm on two thirds, and no region."""
    above, layer = -0.3, 0.0012
    before, after = make_body(rng, 0.0, 0.0, above), make_body(rng, 0.7, layer, above)
    known = register(after, before, within=lambda x: x[:, 2] < (above - 0.08) * np.linalg.norm(x, axis=1))
    result = compare(before, after, known, stable_is_given=True)
    assert list(result.regions["kind"]) == ["cleaned"]
    assert result.regions["mean_m"][0] == pytest.approx(-layer, abs=5e-5)
    area = trimesh.Trimesh(after.vertices, after.faces, process=False).area * area_above(after, above)
    assert result.regions["area_m2"][0] == pytest.approx(area, rel=0.08)
    assert result.statistics["lod95_median_m"] < 4e-4
    assert not result.statistics["offset_is_told"]


@pytest.mark.parametrize(("layer", "told"), [(0.0, False), (0.0004, False), (0.0012, True), (-0.0012, True)])
def test_a_layer_taken_off_all_over_is_told_as_an_offset_of_the_whole(
    rng: np.random.Generator, layer: float, told: bool
) -> None:
    """No region, and "no change was found", with a level of detection as high as the layer was thick."""
    before, after = make_body(rng, 0.0, 0.0, -2.0), make_body(rng, 0.7, layer, -2.0)
    result = compare(before, after)
    figures = result.statistics
    assert not len(result.regions)
    assert figures["offset_m"] == pytest.approx(-layer, abs=5e-5)
    # what scans disagree by counts as common to all, in both epochs; noise that agrees over 3 cm adds little
    assert figures["sigma_offset_m"] == pytest.approx(np.sqrt(2.0) * SHARED, rel=0.25)
    assert figures["offset_is_told"] is told


def test_what_no_scan_disagrees_about_is_as_sure_as_its_parts_scatter(rng: np.random.Generator) -> None:
    found = []
    for _ in range(8):
        bodies = [replace(make_body(rng, turn, 0.0, -2.0), sigma_shared=None) for turn in (0.0, 0.7)]
        n = len(bodies[0].vertices)
        known = Registration(np.eye(4), np.zeros((6, 6)), np.zeros(3), True, stable_share=1.0,
                             is_stable=np.ones(n, dtype=bool))  # fmt: skip
        figures = compare(*bodies, known).statistics
        found.append((figures["offset_m"], figures["sigma_offset_m"]))
    offset, sigma = np.array(found).T  # besides, every vertex lies 0.03 mm before the other body's flat faces
    assert 0.5 < np.std(offset, ddof=1) / sigma.mean() < 1.6
    assert sigma.max() < 2e-5


def values_of(parts: list[tuple[float, float, int]], rng: np.random.Generator) -> Floats:
    return np.concatenate([rng.normal(middle, sigma, n) for middle, sigma, n in parts])


@pytest.mark.parametrize(
    ("parts", "apart"),
    [
        ([(0.0, 1.0, 1000)], 0.0),
        ([(0.0, 1.0, 700), (-5.0, 1.3, 300)], 0.3),
        ([(0.0, 1.0, 700), (5.0, 1.3, 300)], 0.3),
        ([(0.0, 1.0, 950), (-8.0, 1.0, 50)], 0.0),  # too few to move a scale
        ([(0.0, 1.0, 600), (0.0, 5.0, 400)], 0.0),  # a tail
        ([(0.0, 1.0, 600), (5.0, 0.3, 80), (9.0, 0.3, 80), (14.0, 0.3, 80), (19.0, 0.3, 80), (24.0, 0.3, 80)], 0.0),
    ],
)
def test_a_group_stands_apart_where_few_lie_between(
    rng: np.random.Generator, parts: list[tuple[float, float, int]], apart: float
) -> None:
    values = values_of(parts, rng)
    found = stand_apart(values, np.ones(len(values)), np.abs(values) < 3.0)
    assert found.mean() == pytest.approx(apart, abs=0.03)
    assert not found.any() or abs(np.sum(np.sign(values[found]))) == np.count_nonzero(found)


def test_values_count_by_their_weights(rng: np.random.Generator) -> None:
    values = values_of([(0.0, 1.0, 900), (6.0, 1.0, 60)], rng)
    weights = np.where(np.arange(len(values)) < 900, 1.0, 5.0)
    near = np.abs(values) < 3.0
    assert not stand_apart(values, np.ones(len(values)), near).any()
    assert stand_apart(values, weights, near)[900:].all()


def test_values_without_any_weight_are_no_group() -> None:
    assert not stand_apart(np.array([-1.0, 1.0]), np.zeros(2), np.zeros(2, dtype=bool)).any()
    assert not stand_apart(np.zeros(2), np.zeros(2), np.ones(2, dtype=bool)).any()
