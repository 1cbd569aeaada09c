"""A layer on most of an object: the rest is stable, and what was cleaned is one region."""

import re
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from layered_body import area_above, make_body

from monitor.comparison import compare
from monitor.registration import register
from monitor.registration.motion.layer_on_most import Parted, part_patches
from monitor.registration.motion.patch_sums import Patches
from monitor.robust import robust_scale
from projects.transforms import apply


@pytest.mark.parametrize(("layer", "above", "seed"), [(0.001, -0.15, 1), (-0.001, -0.3, 3), (0.0015, -0.5, 5)])
def test_a_figure_cleaned_or_coated_all_but_its_base_is_one_region(layer: float, above: float, seed: int) -> None:
    """No motion was the majority's: no region was found, under a level of 1 to 1.8 mm."""
    rng = np.random.default_rng(seed)
    before, after = make_body(rng, 0.0, 0.0, above), make_body(rng, 0.7, layer, above)
    result = compare(before, after)
    motion = result.registration
    share = area_above(after, above)
    assert motion.stable_is_rest
    assert np.isnan(motion.layer)
    assert motion.stable_share == pytest.approx(1.0 - share, abs=0.07)
    told = re.search(r"the rest lies ([0-9.]+) mm further (in|out)", motion.doubt)
    assert told
    assert float(told[1]) == pytest.approx(1e3 * abs(layer), abs=0.06)
    assert told[2] == ("in" if layer > 0 else "out")
    way = apply(motion.T_target_source, before.vertices) - before.vertices
    assert np.sqrt(np.mean(np.sum(way**2, axis=1))) < 2e-4
    assert list(result.regions["kind"]) == ["cleaned" if layer > 0 else "coated"]
    assert result.regions["mean_m"][0] == pytest.approx(-layer, abs=6e-5)
    area = trimesh.Trimesh(after.vertices, after.faces, process=False).area * share
    assert result.regions["area_m2"][0] == pytest.approx(area, rel=0.06)
    assert result.statistics["lod95_median_m"] < 4.5e-4
    base = np.abs(result.on_compared.distances[after.vertices[:, 2] < (above - 0.1) * 0.13])
    assert np.nanmedian(base) < 1.5e-4


def test_what_is_taken_for_stable_is_said_beside_other_doubts(monkeypatch: pytest.MonkeyPatch) -> None:
    """A doubt about the layer took the place of the words on what was taken for stable."""
    monkeypatch.setattr(
        "monitor.registration.motion.layer.stated_scatter", lambda _, patches, __: robust_scale(patches.mean) / 1.2
    )
    rng = np.random.default_rng(1)
    found = register(make_body(rng, 0.7, 0.001, -0.15), make_body(rng, 0.0, 0.0, -0.15))
    assert found.stable_is_rest
    assert "stable is taken to be the smaller part" in found.doubt
    assert "beside a layer on most of it" in found.doubt


def test_a_layer_that_the_next_round_does_not_tell_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a panel, 70 % of which was coated by 0.8 mm, rounds went to and fro: the last one told a layer of 0.046 mm."""
    rounds: list[Parted] = []

    def part_otherwise(patches: Patches, rng: np.random.Generator) -> Parted:
        found = part_patches(patches, rng)
        rounds.append(found)
        if len(rounds) == 1:
            return found
        return replace(found, motion=np.array([*found.motion[:6], 5e-5]), has_layer=np.arange(len(found.left)) % 3 > 0)

    monkeypatch.setattr("monitor.registration.motion.layer_on_most.part_patches", part_otherwise)
    rng = np.random.default_rng(1)
    found = register(make_body(rng, 0.7, 0.001, -0.15), make_body(rng, 0.0, 0.0, -0.15))
    assert len(rounds) == 2
    assert not found.stable_is_rest
    assert "smaller part" not in found.doubt


@pytest.mark.parametrize(
    ("layer", "above"),
    [(0.0, 0.0), (0.001, -2.0), (0.001, 0.0), (0.0015, 1 / 3)],
    ids=["none", "all over", "half", "a third"],
)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_rest_is_stable_only_beside_a_layer_on_most(layer: float, above: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    found = register(make_body(rng, 0.7, layer, above), make_body(rng, 0.0, 0.0, above))
    assert not found.stable_is_rest


def test_two_parts_that_lie_off_each_by_its_own_are_no_layer_on_most() -> None:
    """Cleaned by 1 mm, the base coated by 0.5 mm: nothing lies where it lay."""
    rng = np.random.default_rng(4)
    before, after = make_body(rng, 0.0, 0.0, -0.2), make_body(rng, 0.7, 0.0015, -0.2)
    normals = trimesh.Trimesh(after.vertices, after.faces, process=False).vertex_normals
    lifted = after.vertices + 0.0005 * normals
    assert not register(replace(after, vertices=lifted), before).stable_is_rest
