"""Regions and their figures against bodies whose change is known exactly; patches and their noise against formulas."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from scipy.signal import fftconvolve
from scipy.stats import norm, t

from monitor.comparison import compare, lague_lod95, level_of_detection
from monitor.comparison.detection.patches import benjamini_hochberg
from monitor.comparison.distances.shell import make_shell
from monitor.comparison.noise.correlation import Correlation
from monitor.comparison.noise.level_of_detection import estimate_floor
from monitor.comparison.noise.scan_errors import AS_STATED, ScanErrors
from monitor.comparison.regions.borders import sigma_of_area
from monitor.comparison.regions.figures import RegionView, find_extreme, name_kind, settle_kind, stands_out
from projects.errors import ParameterError
from projects.model import Z95, Registration, Surface


def sphere(radius_at: object = None) -> Surface:
    """Return a sphere of 0.1 m, its vertices moved outwards by a function (n, 3) -> (n,) of their directions."""
    mesh = trimesh.creation.icosphere(subdivisions=5)
    out = 0.0 if radius_at is None else radius_at(mesh.vertices)  # type: ignore[operator]
    return Surface(mesh.vertices * (0.1 + np.broadcast_to(out, len(mesh.vertices)))[:, None], mesh.faces)


def known(surface: Surface) -> Registration:
    n = len(surface.vertices)
    return Registration(np.eye(4), np.diag([1e-7] * 3 + [1e-8] * 3) ** 2, np.zeros(3), True, stable_share=1.0,
                        is_stable=np.ones(n, dtype=bool))  # fmt: skip


def cap(depth: float, half_angle: float):
    """Return a cosine bump around +z, as a function of directions."""

    def out(directions: np.ndarray) -> np.ndarray:
        angle = np.arccos(np.clip(directions[:, 2], -1.0, 1.0))
        return np.where(angle < half_angle, 0.5 * depth * (1 + np.cos(np.pi * angle / half_angle)), 0.0)

    return out


@pytest.mark.parametrize("depth", [5e-3, -5e-3])
def test_volume_between_curved_surfaces_is_that_of_the_bodies(rng: np.random.Generator, depth: float) -> None:
    noise = 2e-5
    reference, compared = (
        sphere(lambda v: rng.normal(0, noise, len(v))),
        sphere(lambda v: cap(depth, 0.5)(v) + rng.normal(0, noise, len(v))),
    )
    truth = (trimesh.Trimesh(compared.vertices, compared.faces, process=False).volume
             - trimesh.Trimesh(reference.vertices, reference.faces, process=False).volume)  # fmt: skip
    result = compare(reference, compared, known(compared))
    assert len(result.regions) == 1
    region = result.regions.iloc[0]
    assert region.volume_m3 == pytest.approx(truth, rel=0.02)
    assert region.extreme_m == pytest.approx(depth, rel=0.02)
    assert region.kind == ("added" if depth > 0 else "lost")
    assert np.hypot(region.x, region.y) < 2e-3  # of a body 0.1 m wide with vertices 2.4 mm apart
    assert region.z == pytest.approx(0.096, abs=5e-3)
    assert 0.0 < region.sigma_volume_m3 < 0.05 * abs(truth)
    assert 0.0 < region.sigma_area_m2 < 0.2 * region.area_m2


def sheet(height: np.ndarray, side: int, edge: float, reach: float) -> Surface:
    """Return a grid of side x side vertices, as fits of `reach` to points half as far apart would leave it."""
    i = np.arange((side - 1) * side).reshape(side - 1, side)[:, :-1].ravel()
    faces = np.vstack([np.c_[i, i + side, i + 1], np.c_[i + 1, i + side, i + side + 1]])
    x, y = np.divmod(np.arange(side * side), side)
    spacing = 0.5 * edge
    return Surface(np.c_[edge * x, edge * y, height.ravel()], faces, sigma=np.full(side * side, 2e-5),
                   n_support=np.full(side * side, round(np.pi * (reach / spacing) ** 2), np.int32),
                   sample_distance=np.full(side * side, 0.40 * spacing))  # fmt: skip


def test_the_volume_of_a_step_holds_what_its_fits_swing_to_the_other_side(rng: np.random.Generator) -> None:
    side, edge, reach, depth, half = 81, 1.5e-3, 10e-3, 1e-3, 7
    g = np.arange(-7, 8) * edge
    t2 = (g[:, None] ** 2 + g**2) / reach**2
    kernel = np.where(t2 < 1.0, (1.0 - 2.0 * t2) * (1.0 - t2), 0.0)  # that of quadric fits weighted by 1 - t^2
    step = np.zeros((side, side))
    step[40 - half : 41 + half, 40 - half : 41 + half] = depth
    seen = fftconvolve(step, kernel / kernel.sum(), mode="same")
    before, after = (sheet(h + 2e-5 * rng.normal(size=h.shape), side, edge, reach) for h in (0.0 * seen, seen))
    result = compare(before, after, known(after))
    truth = depth * ((2 * half + 1) * edge) ** 2
    assert result.regions.volume_m3[0] == pytest.approx(truth, rel=0.01)  # up to the first zero: 4 % more
    # the swing itself, 0.06 mm, is told beside it in one draw of four: what fits make is no change, but nobody knows
    assert (result.regions.area_m2[1:] < 0.15 * result.regions.area_m2[0]).all()


@pytest.mark.parametrize("depth", [3e-4, -2e-3])
def test_the_volume_of_a_step_is_whole_where_errors_of_neighbours_have_nothing_in_common(
    rng: np.random.Generator, depth: float
) -> None:
    """The margin was narrower than an edge there, and the faces that hold the step were left out: a seventh of it."""
    side, edge, half = 101, 1.2e-3, 8
    step = np.zeros((side, side))
    step[50 - half : 51 + half, 50 - half : 51 + half] = depth
    noise = 2e-5 * rng.normal(size=(2, side, side))
    before, after = (replace(sheet(h, side, edge, edge), n_support=None, sample_distance=None)
                     for h in (noise[0], step + noise[1]))  # fmt: skip
    region = compare(before, after, known(after)).regions.iloc[0]
    truth = depth * ((2 * half + 1) * edge) ** 2
    assert region.volume_m3 == pytest.approx(truth, abs=3.0 * region.sigma_volume_m3)
    assert region.sigma_volume_m3 < 0.02 * abs(truth)


def border_of(profile: Callable[[np.ndarray], np.ndarray]) -> tuple[float, float]:
    """Return the sigma of the area of what changed beyond 1 on a sheet of 100 x 100 vertices a metre apart, as
    `profile` says of x, and what a border that is known to a spacing alone makes of it."""
    n = 100
    flat = sheet(np.zeros((n, n)), n, 1.0, 1.0)
    neighbours = make_shell(flat, np.zeros(3), (1.0, 1.0)).neighbours
    side = SimpleNamespace(surface=flat, neighbours=neighbours, areas=np.ones(n * n), states_noise=False)
    change, level = profile(flat.vertices[:, 0]), np.ones(n * n)
    inside, everywhere = np.flatnonzero(change > level), np.ones(n * n, dtype=bool)
    agree = Correlation(np.array([1.0]), np.array([1e9]))  # errors agree all along the border
    found = sigma_of_area(side, change, level, (inside, everywhere), agree)  # type: ignore[arg-type]
    return found, 2.0 * np.sqrt(np.pi * len(inside) / 3.0)


def test_the_border_of_a_step_is_known_to_a_spacing_whatever_lies_around() -> None:
    found, spacing = border_of(lambda x: np.where(x < 30.0, 5.0, 0.6))  # beyond it half a level, as errors may lie
    assert found == pytest.approx(spacing)
    found, spacing = border_of(lambda x: np.where(x < 30.0, 5.0, -0.8))
    assert found == pytest.approx(spacing)


def test_the_border_of_what_fades_out_moves_with_the_errors_there() -> None:
    found, spacing = border_of(lambda x: 2.0 - 0.02 * x)  # a sigma, 1 / 1.96 of the level, is 25.5 long, 100 wide
    assert np.sqrt(found**2 - spacing**2) == pytest.approx(100.0 / 0.02 / Z95, rel=0.04)


def test_what_lies_apart_does_not_move_the_border() -> None:
    found, spacing = border_of(lambda x: np.where(x < 30.0, 5.0, np.where(x > 60.0, 0.9, 0.0)))
    assert found == pytest.approx(spacing)


def test_the_extreme_is_not_where_the_change_is_known_worst(rng: np.random.Generator) -> None:
    def is_blurred(directions: np.ndarray) -> np.ndarray:
        return np.linalg.norm(directions - [np.sin(0.25), 0.0, np.cos(0.25)], axis=1) < 0.1

    def worn(directions: np.ndarray) -> np.ndarray:
        noise = rng.normal(0, 2e-5, len(directions))
        return cap(-3e-3, 0.7)(directions) + noise + np.where(is_blurred(directions), -1.5e-3, 0.0)

    reference = sphere(lambda v: rng.normal(0, 2e-5, len(v)))
    compared = sphere(worn)
    directions = compared.vertices / np.linalg.norm(compared.vertices, axis=1)[:, None]
    states = np.where(is_blurred(directions), 8e-4, 2e-5)  # it errs there by two of the sigmas that it states
    compared = Surface(compared.vertices, compared.faces, sigma=states)
    reference = Surface(reference.vertices, reference.faces, sigma=np.full(len(reference.vertices), 2e-5))
    region = compare(reference, compared, known(compared)).regions.iloc[0]
    assert region.extreme_m == pytest.approx(-3e-3, abs=2e-4)
    assert 1e-5 < region.sigma_extreme_m < 1e-4  # of its own place


@pytest.mark.parametrize(("n", "n_told"), [(9, 3), (20, 5), (40, 7)])
def test_the_extreme_of_what_no_vertex_assesses_is_its_largest_gap_and_its_sigma_is_not_known(n, n_told) -> None:
    unknown = np.full(n, np.nan)
    place = np.column_stack([np.arange(n, dtype=float), np.zeros((n, 2))])
    side = SimpleNamespace(areas=np.ones(n), is_assessed=np.zeros(n, dtype=bool), distances=unknown,
                           sigma_shared=unknown, limb_of=lambda which: unknown[which], sigma_motion=unknown,
                           surface=SimpleNamespace(vertices=place))  # fmt: skip
    noise = SimpleNamespace(parts_of=lambda side, which: np.zeros((2, len(which))))
    found = SimpleNamespace(sides=[SimpleNamespace(mean=unknown)], noise=noise)
    gaps = -1e-3 * np.arange(1.0, n + 1.0)
    extreme, sigma = find_extreme(side, found, 0, (np.zeros(0, dtype=int), np.arange(n)), gaps)  # type: ignore[arg-type]
    assert extreme == pytest.approx(-1e-3 * (n - (n_told - 1) / 2))  # the median of so many nearest to the last
    assert np.isnan(sigma)


def test_two_changes_are_two_regions_the_larger_first(rng: np.random.Generator) -> None:
    def two(v: np.ndarray) -> np.ndarray:
        return cap(3e-3, 0.5)(v) + cap(-3e-3, 0.3)(-v) + rng.normal(0, 2e-5, len(v))

    compared = sphere(two)
    table = compare(sphere(lambda v: rng.normal(0, 2e-5, len(v))), compared, known(compared)).regions
    assert list(table.region) == [1, 2]
    assert list(table.kind) == ["added", "lost"]
    assert table.area_m2[0] > table.area_m2[1]
    assert table.z[0] > 0 > table.z[1]


def test_every_region_number_is_found_on_the_surfaces(rng: np.random.Generator) -> None:
    compared = sphere(lambda v: cap(3e-3, 0.5)(v) + rng.normal(0, 2e-5, len(v)))
    result = compare(sphere(lambda v: rng.normal(0, 2e-5, len(v))), compared, known(compared))
    for side in (result.on_compared, result.on_reference):
        assert set(np.unique(side.region)) == {0, 1}
        np.testing.assert_array_equal(side.region > 0, side.assessment == 2)


def test_level_of_detection_is_the_root_of_the_squares() -> None:
    lod = level_of_detection(np.array([3e-3]), np.array([4e-3]), 12e-3)
    assert lod[0] == pytest.approx(1.959964 * 13e-3, rel=1e-6)


def test_lague_adds_the_registration_linearly() -> None:
    lod = lague_lod95(np.array([0.03]), np.array([9]), np.array([0.04]), np.array([16]), 0.005)
    assert lod[0] == pytest.approx(1.96 * (np.sqrt(1e-4 + 1e-4) + 0.005), rel=1e-12)


def test_a_negative_spread_number_or_error_has_no_level_of_detection() -> None:
    """A negative spread passed for its size, -5 points for NaN, and an error of -1 cm made the level smaller."""
    for wrong in ((-0.03, 9, 0.04, 16, 0.005), (0.03, -5, 0.04, 16, 0.005), (0.03, 9, 0.04, 16, -0.01)):
        with pytest.raises(ParameterError, match="0 or more is allowed, NaN where it is not known"):
            lague_lod95(*wrong)  # type: ignore[arg-type]
    assert np.isnan(lague_lod95(np.array([np.nan]), np.array([9]), np.array([0.04]), np.array([16]), 0.005)).all()


def test_floor_is_what_is_missing_to_the_spread(rng: np.random.Generator) -> None:
    sigma = rng.uniform(0.5e-3, 1.5e-3, 100_000)
    distances = rng.normal(0, np.hypot(sigma, 2e-3))
    assert estimate_floor(distances, sigma) == pytest.approx(2e-3, rel=0.02)
    assert estimate_floor(distances, sigma, 0.6827) == pytest.approx(2e-3, rel=0.02)
    assert estimate_floor(0.1 * sigma * norm.ppf(0.9), sigma) == 0.0


def test_benjamini_hochberg_gives_the_textbook_answer() -> None:
    p = np.array([0.001, 0.008, 0.039, 0.041, 0.042, 0.06, 0.074, 0.205, 0.212, 0.216])
    assert benjamini_hochberg(p, 0.05) == 0.008
    assert benjamini_hochberg(p, 0.10) == 0.06
    assert benjamini_hochberg(np.ones(5), 0.05) == 0.0
    assert benjamini_hochberg(np.zeros(0), 0.05) == 0.0


@pytest.mark.parametrize(
    ("mean", "spread", "area", "kind"),
    [(-1e-2, 8e-3, 0.01, "lost"), (1e-2, 8e-3, 0.01, "added"), (-1e-3, 1e-4, 0.04, "cleaned"),
     (1e-3, 1e-4, 0.04, "coated"), (-1e-2, 1e-4, 0.01, "lost"), (1e-4, 1e-4, 0.01, "unclear"),
     (-4.9e-3, 1e-4, 0.2, "cleaned"), (4.9e-3, 1e-4, 0.2, "coated"),  # a coat of plaster
     (-5.1e-3, 1e-4, 0.2, "lost"), (5.1e-3, 1e-4, 0.2, "added"), (-2e-2, 1e-4, 0.22, "lost")],  # tiles, a board
)  # fmt: skip
def test_kinds_follow_sign_evenness_width_and_thickness(mean: float, spread: float, area: float, kind: str) -> None:
    assert name_kind(mean, 1e-4, spread, area) == kind


@pytest.mark.parametrize(
    ("kind", "volume", "settled"),
    [("unclear", -1.9, "unclear"), ("unclear", -2.0, "lost"), ("unclear", 2.0, "added"), ("coated", -1.9, "coated"),
     ("coated", -2.0, "unclear"), ("added", -2.0, "unclear"), ("lost", 2.0, "unclear"), ("cleaned", -9.0, "cleaned"),
     ("lost", np.nan, "lost"), ("unclear", np.nan, "unclear")],
)  # fmt: skip
def test_a_volume_beyond_its_margin_settles_the_kind_and_contradicts_it(kind: str, volume: float, settled: str) -> None:
    assert settle_kind(kind, volume, 1.0) == settled


def test_volume_is_unknown_where_much_of_a_region_ends_at_a_free_edge(rng: np.random.Generator) -> None:
    reference, compared = sphere(), sphere(lambda v: cap(-5e-3, 0.5)(v) + rng.normal(0, 2e-5, len(v)))
    middle = compared.vertices[compared.faces].mean(axis=1)
    left = Surface(compared.vertices, compared.faces[~((middle[:, 2] > 0.05) & (middle[:, 0] > 0.0))])
    result = compare(reference, left, known(left))
    assert len(result.regions) == 1
    assert np.isnan(result.regions.iloc[0].volume_m3)
    assert np.isnan(result.regions.iloc[0].sigma_volume_m3)
    assert result.regions.iloc[0].mean_m < 0


def test_a_sheet_seen_in_one_epoch_only_is_not_taken_for_a_loss(rng: np.random.Generator) -> None:
    reference, outer = sphere(lambda v: rng.normal(0, 2e-5, len(v))), sphere(lambda v: rng.normal(0, 2e-5, len(v)))
    inner = outer.faces[(outer.vertices[outer.faces][:, :, 2] > 0.06).all(axis=1)]
    n = len(outer.vertices)
    both = Surface(np.vstack([outer.vertices, 0.93 * outer.vertices]), np.vstack([outer.faces, inner + n]))
    result = compare(reference, both, known(both))
    assert len(result.regions) == 0
    behind = np.unique(inner) + n
    assert (result.on_compared.assessment[behind] == 0).all()  # 7 mm behind: neither changed nor unchanged
    assert np.isnan(result.on_compared.distances[behind]).all()


def view_of(mean: float, sigma: float, measured: float | None = None, stated: float = 0.0) -> RegionView:
    """Return a region as one side sees it, of which only the mean and its sigma matter, with a guess and without, and
    what its scans are stated to disagree by."""
    largest, measured = (mean, sigma), sigma if measured is None else measured
    return RegionView(
        -1.0, 0.0, 1e-3, 1e-5, 0.0, 0.0, mean, sigma, measured, stated, largest, largest, np.zeros(3), 0.0, (0.0, 0.0)
    )


def test_sides_that_disagree_on_how_much_do_not_make_a_loss_doubtful() -> None:
    assert stands_out([view_of(-6e-3, 5e-4), view_of(-3e-3, 5e-4)], AS_STATED) == pytest.approx(6.0)  # the weaker one
    assert stands_out([view_of(-6e-3, 5e-4)], AS_STATED) == pytest.approx(12.0)
    assert stands_out([view_of(-6e-3, 5e-4), view_of(3e-3, 5e-4)], AS_STATED) == pytest.approx(-6.0)  # one is wrong
    assert np.isnan(stands_out([view_of(-6e-3, np.nan)], AS_STATED))


def test_a_region_stands_out_with_what_its_surfaces_guess_or_without() -> None:
    view = view_of(-6e-3, 4e-3, 5e-4)
    assert stands_out([view], AS_STATED) == pytest.approx(1.5)
    assert stands_out([view], AS_STATED, is_guessed=False) == pytest.approx(12.0)


def test_a_region_stands_out_less_where_its_scans_are_known_by_few_places() -> None:
    """Six sigmas of ten degrees of freedom are as much as 3.8 of a normal distribution, gained or lost."""
    scans = ScanErrors(np.zeros(1), np.array([0.5]), np.array([10.0]))
    assert stands_out([view_of(-3e-3, 5e-4, stated=1e-3)], scans) == pytest.approx(norm.isf(t.sf(6.0, 10.0)), rel=1e-6)
    assert stands_out([view_of(3e-3, 5e-4, stated=1e-3)], scans) == pytest.approx(3.82, abs=0.05)
    half = 10.0 / 0.25**2  # of a variance of which a quarter is the scans'
    assert stands_out([view_of(3e-3, 5e-4, stated=5e-4)], scans) == pytest.approx(norm.isf(t.sf(6.0, half)), rel=1e-6)
