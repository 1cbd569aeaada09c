"""Two epochs in, what changed out: simulated pairs with known truth."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from monitor.comparison import CompareSettings, compare
from projects.errors import ComparisonError, ParameterError, RegistrationError
from projects.model import Assessment, Floats, PointCloud, Registration, Surface

NOISE = 1e-4


def make_sheet(rng: np.random.Generator, n: int = 120, step: float = 1e-3, change: Floats | None = None) -> Surface:
    """Return a bumpy sheet of n x n vertices, its noise mostly correlated, with `change` (n, n) added upwards."""
    from scipy.ndimage import gaussian_filter

    x, y = np.meshgrid(np.arange(n) * step, np.arange(n) * step, indexing="ij")
    z = 5e-3 * np.sin(x / 0.02) * np.cos(y / 0.03)
    smooth = gaussian_filter(rng.normal(size=(n, n)), 2.0)
    z = z + NOISE * (0.98 * smooth / smooth.std() + 0.2 * rng.normal(size=(n, n)))
    if change is not None:
        z = z + change
    i, j = np.meshgrid(np.arange(n - 1), np.arange(n - 1), indexing="ij")
    a = (i * n + j).ravel()
    faces = np.vstack([np.column_stack([a, a + n, a + n + 1]), np.column_stack([a, a + n + 1, a + 1])])
    vertices = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    return Surface(vertices, faces, sigma=np.full(n * n, NOISE))


def known_motion(surface: Surface) -> Registration:
    """Return an identity registration known to a hundredth of the noise."""
    covariance = np.diag([1e-6 / 0.05] * 3 + [1e-6] * 3) ** 2
    is_stable = np.ones(len(surface.vertices), dtype=bool)
    return Registration(np.eye(4), covariance, surface.vertices.mean(axis=0), True, stable_share=1.0,
                        is_stable=is_stable)  # fmt: skip


def bowl(n: int, step: float, depth: float, radius: float) -> Floats:
    """Return a cosine bowl in the middle of the sheet, downwards."""
    x, y = np.meshgrid(np.arange(n) * step, np.arange(n) * step, indexing="ij")
    r = np.hypot(x - x.mean(), y - y.mean())
    return np.where(r < radius, -0.5 * depth * (1.0 + np.cos(np.pi * r / radius)), 0.0)


def test_share_beyond_the_tolerance_is_of_the_area_and_not_of_the_vertices(rng: np.random.Generator) -> None:
    """Vertices lie nine times as densely on the quarter that rose by 4 mm."""
    reference, compared = make_sheet(rng, 80), make_sheet(rng, 80)
    i = np.repeat(np.arange(80), 80)
    x = np.where(i < 60, i * 0.02 / 60, 0.02 + (i - 60) * 0.059 / 19)
    lift = 0.004 * np.clip((0.022 - x) / 0.004, 0.0, 1.0)
    flat = [s.vertices[:, 2] - 5e-3 * np.sin(s.vertices[:, 0] / 0.02) * np.cos(s.vertices[:, 1] / 0.03)
            for s in (reference, compared)]  # fmt: skip
    reference = dataclasses.replace(reference, vertices=np.c_[reference.vertices[:, :2], flat[0]])
    compared = dataclasses.replace(compared, vertices=np.c_[x, compared.vertices[:, 1], flat[1] + lift])
    result = compare(reference, compared, known_motion(compared), tolerance=0.002)
    assert result.statistics["share_beyond_tolerance"] == pytest.approx(0.25, abs=0.04)
    is_beyond = np.abs(result.on_compared.distances) > 0.002
    assert is_beyond[np.isfinite(result.on_compared.distances)].mean() > 0.6
    assert 0.8 < result.statistics["assessed_area_share_reference"] < 0.95  # on the ramp it has no counterpart


def test_what_errors_put_beyond_the_tolerance_did_not_change_beyond_it(rng: np.random.Generator) -> None:
    reference, sunk = make_sheet(rng, 70), make_sheet(rng, 70, change=bowl(70, 1e-3, 0.006, 0.02))
    result = compare(reference, sunk, known_motion(sunk), tolerance=1e-4)
    side, figures = result.on_compared, result.statistics
    is_beyond = np.abs(side.distances) > 1e-4
    assessed = side.assessment != Assessment.NOT_ASSESSABLE
    changed = (is_beyond & (side.assessment == Assessment.CHANGED))[assessed].mean()
    assert 0.05 < changed < 0.8 * is_beyond[assessed].mean()  # the rest is noise
    assert figures["share_changed_beyond_tolerance"] == pytest.approx(changed, abs=0.02)  # nearly even areas
    assert figures["share_beyond_tolerance"] == pytest.approx(is_beyond[assessed].mean(), abs=0.02)


def test_unchanged_pairs_rarely_show_a_region_and_exceed_lod95_at_five_percent(rng: np.random.Generator) -> None:
    n_with_region, shares = 0, []
    for _ in range(12):
        reference, compared = make_sheet(rng, 70), make_sheet(rng, 70)
        result = compare(reference, compared, known_motion(compared))
        n_with_region += len(result.regions) > 0
        shares.append(result.statistics["share_above_lod95"])
    assert n_with_region <= 2  # 5 % of 12 pairs: more than 2 has a chance of 2 %
    # learned from both sides of a pair, of which one alone is off by 0.1 %; by 1 % where there is a region
    assert np.mean(shares) == pytest.approx(0.05, abs=0.0025)


@pytest.mark.parametrize(("sign", "kind"), [(1.0, "lost"), (-1.0, "added")])
def test_a_bowl_is_found_with_its_sign_place_and_volume(rng: np.random.Generator, sign: float, kind: str) -> None:
    change = sign * bowl(120, 1e-3, 2e-3, 0.02)
    reference, compared = make_sheet(rng), make_sheet(rng, change=change)
    result = compare(reference, compared, known_motion(compared))
    assert len(result.regions) == 1
    region = result.regions.iloc[0]
    truth = float(change.sum()) * 1e-6
    assert region.kind == kind
    assert region.volume_m3 == pytest.approx(truth, rel=0.05)
    assert abs(region.volume_m3 - truth) < 3.0 * region.sigma_volume_m3
    assert region.extreme_m == pytest.approx(-sign * 2e-3, abs=2e-4)
    assert 0.6 * np.pi * 0.02**2 < region.area_m2 < 1.1 * np.pi * 0.02**2
    assert np.hypot(region.x - 0.0595, region.y - 0.0595) < 3e-3  # rms of 20 seeds: 1.03 mm, of the ragged border
    changed = result.on_compared.assessment == Assessment.CHANGED
    assert np.all(np.sign(result.on_compared.distances[changed & (np.abs(change.ravel()) > 1e-3)]) == -sign)


def test_a_steep_change_ends_where_it_ends(rng: np.random.Generator) -> None:
    worn = np.where(bowl(120, 1e-3, 1.0, 0.02) < 0.0, -2e-3, 0.0)  # twenty times its level of detection, from its rim
    reference, compared = make_sheet(rng), make_sheet(rng, change=worn)
    result = compare(reference, compared, known_motion(compared))
    region = result.regions.iloc[0]
    truth = np.pi * 0.02**2
    assert region.area_m2 == pytest.approx(truth, rel=0.10)  # half a vertex all around is 5 %
    assert abs(region.area_m2 - truth) < 3.0 * region.sigma_area_m2
    beside = (result.on_compared.region > 0) & (worn.ravel() == 0.0)
    assert beside.sum() < 0.05 * (worn < 0.0).sum()


def test_both_sides_agree_in_sign_and_swapping_the_epochs_flips_it(rng: np.random.Generator) -> None:
    reference, compared = make_sheet(rng), make_sheet(rng, change=bowl(120, 1e-3, 2e-3, 0.02))
    there = compare(reference, compared, known_motion(compared))
    back = compare(compared, reference, known_motion(reference))
    middle = 60 * 120 + 60
    assert there.on_compared.distances[middle] == pytest.approx(-2e-3, abs=4e-4)
    assert there.on_reference.distances[middle] == pytest.approx(-2e-3, abs=4e-4)
    np.testing.assert_allclose(back.on_reference.distances, -there.on_compared.distances, atol=1e-12)


def test_states_and_numbers_are_nan_and_zero_where_nothing_can_be_said(rng: np.random.Generator) -> None:
    reference, compared = make_sheet(rng), make_sheet(rng)
    half = dataclasses.replace(reference, faces=reference.faces[reference.faces.max(axis=1) < 60 * 120])
    result = compare(half, compared, known_motion(compared))
    unseen = result.on_compared.assessment == Assessment.NOT_ASSESSABLE
    beyond = compared.vertices[:, 0] > 0.062
    assert unseen[beyond].all()
    assert unseen[compared.vertices[:, 0] < 0.056].mean() < 0.09  # the sheet's own rim, two rows of vertices
    np.testing.assert_array_equal(np.isnan(result.on_compared.distances), unseen)
    np.testing.assert_array_equal(np.isnan(result.on_compared.lod95), unseen)
    np.testing.assert_array_equal(result.on_compared.reasons == 0, ~unseen)


def test_unknown_sigma_is_not_assessable(rng: np.random.Generator) -> None:
    reference, compared = make_sheet(rng), make_sheet(rng)
    sigma = compared.sigma.copy()
    sigma[:50] = np.nan
    result = compare(reference, dataclasses.replace(compared, sigma=sigma), known_motion(compared))
    assert (result.on_compared.assessment[:50] == Assessment.NOT_ASSESSABLE).all()
    assert np.isnan(result.on_compared.lod95[:50]).all()


def lower_sheet(rng: np.random.Generator) -> tuple[Surface, Surface, Registration]:
    """Return a sheet, the same 3 mm lower in the later epoch, and the motion between them."""
    reference, compared = make_sheet(rng), make_sheet(rng)
    T = np.eye(4)
    T[:3, 3] = [0.0, 0.0, 3e-3]
    lowered = dataclasses.replace(compared, vertices=compared.vertices - T[:3, 3])
    return reference, lowered, dataclasses.replace(known_motion(compared), T_target_source=T)


def test_relative_mode_removes_a_motion_that_absolute_mode_shows(rng: np.random.Generator) -> None:
    reference, lowered, registration = lower_sheet(rng)
    relative = compare(reference, lowered, registration)
    absolute = compare(reference, lowered, registration, mode="absolute")
    assert abs(np.nanmedian(relative.on_compared.distances)) < 2e-5
    assert np.nanmedian(absolute.on_compared.distances) == pytest.approx(-2.9e-3, abs=1e-4)  # along tilted normals
    assert absolute.statistics["motion_displacement_m"] == pytest.approx(3e-3)


def test_what_the_whole_has_moved_by_is_change_and_no_noise_in_absolute_mode(rng: np.random.Generator) -> None:
    reference, lowered, registration = lower_sheet(rng)
    quiet = compare(reference, lowered, registration).on_compared
    for sigma, changed in ((3e-4, True), (3e-3, False)):  # of the height of both frames
        frames = np.diag([1e-9] * 3 + [sigma] * 3) ** 2
        seen = compare(reference, lowered, registration, mode="absolute", frames=frames).on_compared
        expected = np.hypot(np.nanmedian(quiet.lod95), 1.96 * sigma)  # what is beside the frames is as it was
        assert np.nanmedian(seen.lod95) == pytest.approx(expected, rel=0.05)
        assessed = seen.assessment != Assessment.NOT_ASSESSABLE
        assert np.mean(seen.assessment[assessed] == Assessment.CHANGED) == pytest.approx(float(changed), abs=0.02)


def test_the_motion_told_against_frames_is_no_surer_than_they_are_and_what_it_leaves_is(
    rng: np.random.Generator,
) -> None:
    reference, lowered, registration = lower_sheet(rng)
    frames = np.diag([1e-9] * 3 + [3e-3] * 3) ** 2
    alone = compare(reference, lowered, registration, frames=np.zeros((6, 6)))
    framed = compare(reference, lowered, registration, frames=frames)
    assert np.array_equal(framed.on_compared.lod95, alone.on_compared.lod95, equal_nan=True)
    assert framed.registration.covariance == pytest.approx(registration.covariance + frames)
    assert alone.statistics["motion_is_significant"]
    assert not framed.statistics["motion_is_significant"]


@pytest.mark.parametrize("mode", ["relative", "absolute"])
def test_how_surely_the_whole_moved_is_not_known_where_the_frames_are_not(rng: np.random.Generator, mode: str) -> None:
    """What did not move had moved with a confidence above 99.9 %, by what the poses of the scans erred."""
    reference, lowered, registration = lower_sheet(rng)
    figures = compare(reference, lowered, registration, mode=mode).statistics
    assert figures["motion_displacement_m"] == pytest.approx(3e-3)
    assert np.isnan(figures["motion_significance"])
    assert figures["motion_is_significant"] is None


@pytest.mark.parametrize("frames", [None, np.diag([1e-9] * 3 + [1e-5] * 3) ** 2])
def test_in_absolute_mode_what_is_unchanged_lies_off_as_its_differences_say(
    rng: np.random.Generator, frames: Floats | None
) -> None:
    """The motion was taken off: of a wall laid on all but a third, that third lay as far in as the layer was thick."""
    n, layer = 120, 1.5e-3
    change = np.where(np.arange(n) < 0.62 * n, layer, 0.0)[:, None] * np.ones(n)
    reference, compared = make_sheet(rng, n), make_sheet(rng, n, change=change)
    T = np.eye(4)
    T[2, 3] = -layer  # as the majority says
    laid = change.ravel() > 0.0
    known = dataclasses.replace(known_motion(compared), T_target_source=T, is_stable=laid, stable_share=0.62)
    found = compare(reference, compared, known, mode="absolute", frames=frames)
    assert np.mean(found.on_compared.is_changed[laid]) > 0.9
    assert np.mean(found.on_compared.is_changed[~laid]) < 0.05
    assert found.statistics["offset_m"] == pytest.approx(0.0, abs=5e-5)
    assert not found.statistics["offset_is_told"]


def test_a_registration_that_did_not_converge_is_refused_with_its_reason(rng: np.random.Generator) -> None:
    sheet = make_sheet(rng, 20)
    failed = dataclasses.replace(known_motion(sheet), converged=False, reason="a plane slides")
    with pytest.raises(RegistrationError, match="a plane slides"):
        compare(sheet, sheet, failed)
    with pytest.raises(RegistrationError, match="could not be registered: it did not converge; do they overlap"):
        compare(sheet, sheet, dataclasses.replace(failed, reason=""))


def test_epochs_that_do_not_overlap_are_refused(rng: np.random.Generator) -> None:
    sheet = make_sheet(rng, 20)
    far = dataclasses.replace(sheet, vertices=sheet.vertices + 5.0)
    with pytest.raises(ComparisonError, match="do not overlap"):
        compare(sheet, far)
    with pytest.raises(ComparisonError, match="do not overlap"):
        compare(sheet, far, known_motion(sheet))


def test_settings_and_mode_out_of_range_are_refused(rng: np.random.Generator) -> None:
    sheet = make_sheet(rng, 20)
    with pytest.raises(ParameterError, match="relative and absolute"):
        compare(sheet, sheet, known_motion(sheet), mode="both")
    with pytest.raises(ParameterError, match="search_limit"):
        CompareSettings(search_limit=-1.0)


def test_what_is_no_surface_no_length_or_no_rigid_motion_is_refused_by_name(rng: np.random.Generator) -> None:
    sheet, other = make_sheet(rng, 20), make_sheet(rng, 20)
    with pytest.raises(ParameterError, match="the compared surface is a PointCloud; a Surface is needed"):
        compare(sheet, PointCloud(sheet.vertices))  # type: ignore[arg-type]
    holed = dataclasses.replace(sheet, vertices=np.where(np.arange(400)[:, None] < 3, np.nan, sheet.vertices))
    with pytest.raises(ComparisonError, match="the reference surface has 3 of 400 vertices that are not finite"):
        compare(holed, other)
    with pytest.raises(ComparisonError, match="the compared surface has no faces"):
        compare(sheet, Surface(sheet.vertices, np.zeros((0, 3), dtype=int)))
    for tolerance in (-0.001, 0.0, float("nan"), float("inf"), "2", True):
        with pytest.raises(ParameterError, match="a length above 0 m is needed"):
            compare(sheet, other, known_motion(other), tolerance=tolerance)  # type: ignore[arg-type]
    doubled = dataclasses.replace(known_motion(other), T_target_source=np.diag([2.0, 2.0, 2.0, 1.0]))
    with pytest.raises(ParameterError, match="the registration: the transform scales by 2 to 2; a rigid"):
        compare(sheet, other, doubled)


@pytest.mark.parametrize("frames", [np.eye(3), -np.eye(6), np.full((6, 6), np.nan)])
def test_how_far_frames_may_differ_is_a_covariance_or_refused(rng: np.random.Generator, frames: np.ndarray) -> None:
    sheet, other = make_sheet(rng, 20), make_sheet(rng, 20)
    with pytest.raises(ParameterError, match=r"frames has shape .*a covariance \(6, 6\)"):
        compare(sheet, other, known_motion(other), frames=frames)


def test_of_a_covariance_that_is_not_symmetric_no_half_is_taken(rng: np.random.Generator) -> None:
    """Its lower half was judged, and all of it used: a rotation and a shift correlated by 5 went through."""
    sheet, other = make_sheet(rng, 20), make_sheet(rng, 20)
    frames = np.eye(6) * 1e-8
    frames[0, 3] = 5e-8
    with pytest.raises(
        ParameterError, match="frames is not symmetric: 5e-08 in row 1, column 4 and 0 in row 4, column"
    ):
        compare(sheet, other, known_motion(other), frames=frames)


def test_given_stable_areas_are_of_the_compared_surface(rng: np.random.Generator) -> None:
    """Of another number of vertices they were passed over: all was judged as if nobody knew what is stable."""
    sheet, other = make_sheet(rng, 20), make_sheet(rng, 20)
    of_others = dataclasses.replace(known_motion(other), is_stable=np.ones(7, dtype=bool))
    with pytest.raises(ParameterError, match=r"the registration's is_stable has 7: give .* each of its 400 vertices"):
        compare(sheet, other, of_others, stable_is_given=True)
    with pytest.raises(ParameterError, match="no registration is given"):
        compare(sheet, other, stable_is_given=True)


def test_what_is_no_pair_of_masks_and_no_covariance_of_the_motion_is_refused(rng: np.random.Generator) -> None:
    """They ended in errors of numpy, and a negative variance passed for none at all."""
    sheet, other = make_sheet(rng, 20), make_sheet(rng, 20)
    motion, mask = known_motion(other), np.zeros(400, dtype=bool)
    for apart in ((mask.tolist(), mask.tolist()), (mask,), 5, (mask.astype(float), mask), (mask, mask[:5])):
        with pytest.raises(ParameterError, match=r"apart is .*: give one mask of bool"):
            compare(sheet, other, motion, apart=apart)  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match="frames has shape"):
        compare(sheet, other, motion, frames=[[1.0], [1.0, 2.0]])  # type: ignore[arg-type]
    for wrong in (-np.eye(6), np.full((6, 6), np.nan)):
        with pytest.raises(ParameterError, match="the registration's covariance has shape"):
            compare(sheet, other, dataclasses.replace(motion, covariance=wrong))
    with pytest.raises(ParameterError, match="the registration's centre"):
        compare(sheet, other, dataclasses.replace(motion, centre=np.full(3, np.nan)))


def test_where_nothing_can_be_assessed_the_reason_is_told_and_not_that_epochs_do_not_overlap(
    rng: np.random.Generator,
) -> None:
    sheet, other = make_sheet(rng, 20), make_sheet(rng, 20)
    n_faces = len(other.faces)
    soup = Surface(other.vertices[other.faces].reshape(-1, 3), np.arange(3 * n_faces).reshape(-1, 3))
    with pytest.raises(ComparisonError, match="merge those at one place"):
        compare(sheet, soup, dataclasses.replace(known_motion(other), is_stable=None))
    unsure = dataclasses.replace(other, sigma=np.full(400, np.inf))
    with pytest.raises(ComparisonError, match="leaves no level"):
        compare(sheet, unsure, known_motion(other))


def test_the_result_is_the_same_twice_and_inputs_are_untouched(rng: np.random.Generator) -> None:
    reference, compared = make_sheet(rng, 60), make_sheet(rng, 60, change=bowl(60, 1e-3, 2e-3, 0.012))
    before = compared.vertices.copy()
    first = compare(reference, compared, known_motion(compared))
    second = compare(reference, compared, known_motion(compared))
    np.testing.assert_array_equal(first.on_reference.distances, second.on_reference.distances)
    assert first.regions.equals(second.regions)
    np.testing.assert_array_equal(compared.vertices, before)
