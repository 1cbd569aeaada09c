"""A region ends where a change does: not with the skirt that fits make of a step, and not short of where it fades."""

from __future__ import annotations

import numpy as np
import pytest
from bumpy_body import correlated_noise
from scipy.ndimage import gaussian_filter

from monitor.comparison import compare
from projects.model import Assessment, Floats, NotAssessed, Registration, Surface

N, SPACING, BLUR = 121, 1e-3, 1e-3  # vertices a side, m, m: one sigma of what fits make of a step
NOISE, REACH = 3e-5, 3e-3  # m: of a vertex, and as far as neighbours share it
HEIGHT, EDGE, RADIUS = 1e-3, 0.03, 0.012  # m


def sheet(height: Floats, seed: int) -> Surface:
    """Return a flat sheet of even vertices at these heights (N, N) [m], with noise that neighbours share."""
    i, j = (a.ravel() for a in np.meshgrid(np.arange(N), np.arange(N), indexing="ij"))
    points = np.column_stack([(i - N // 2) * SPACING, (j - N // 2) * SPACING, height.ravel()])
    at = np.flatnonzero((i < N - 1) & (j < N - 1))
    faces = np.vstack([np.column_stack([at, at + N, at + N + 1]), np.column_stack([at, at + N + 1, at + 1])])
    points[:, 2] += correlated_noise(points, np.random.default_rng(seed), NOISE, REACH)
    return Surface(points, faces, sigma=np.full(len(points), NOISE))


def known(surface: Surface) -> Registration:
    n = len(surface.vertices)
    return Registration(np.eye(4), np.diag([1e-7] * 3 + [1e-8] * 3) ** 2, np.zeros(3), True, stable_share=1.0,
                        is_stable=np.ones(n, dtype=bool))  # fmt: skip


def test_a_step_that_fits_have_blurred_has_its_own_area_and_height() -> None:
    x = np.abs(np.arange(N) - N // 2) * SPACING
    raised = HEIGHT * ((x[:, None] < 0.5 * EDGE) & (x[None] < 0.5 * EDGE))
    reference, compared = sheet(np.zeros((N, N)), 1), sheet(gaussian_filter(raised, BLUR / SPACING), 2)
    table = compare(reference, compared, known(compared)).regions
    assert len(table) == 1
    truth = np.count_nonzero(raised) * SPACING**2
    assert table.area_m2[0] == pytest.approx(truth, rel=0.06)  # with its skirt 1.18 times as much
    assert table.mean_m[0] == pytest.approx(HEIGHT, rel=0.1)  # with its skirt 0.84 of it
    assert table.volume_m3[0] == pytest.approx(HEIGHT * truth, rel=0.02)


def test_a_change_that_fades_out_keeps_its_rim() -> None:
    x = np.arange(N) - N // 2
    r = np.hypot(x[:, None], x[None]) * SPACING
    bowl = np.where(r < RADIUS, -0.5 * HEIGHT * (1 + np.cos(np.pi * r / RADIUS)), 0.0)
    reference, compared = sheet(np.zeros((N, N)), 1), sheet(bowl, 2)
    result = compare(reference, compared, known(compared))
    assert len(result.regions) == 1
    beyond = np.count_nonzero(np.abs(bowl) > float(np.nanmedian(result.on_compared.lod95))) * SPACING**2
    assert result.regions.area_m2[0] == pytest.approx(beyond, rel=0.1)


@pytest.mark.parametrize("flank", [0.003, 0.004, 0.005, 0.006])
def test_a_flank_that_is_cut_off_as_a_skirt_is_not_called_unchanged(flank: float) -> None:
    """It is few vertices wide: what fits make of a step and what fades out look alike."""
    x = np.arange(N) - N // 2
    r = np.hypot(x[:, None], x[None]) * SPACING
    depth, floor = 2.0 * HEIGHT, 0.004  # m
    bowl = -0.5 * depth * (1 + np.cos(np.pi * np.clip((r - floor) / flank, 0.0, 1.0)))
    reference, compared = sheet(np.zeros((N, N)), 1), sheet(bowl, 2)
    result = compare(reference, compared, known(compared))
    for side in (result.on_compared, result.on_reference):
        is_deep = np.abs(bowl.ravel()) > 5.0 * float(np.nanmedian(side.lod95))
        assert is_deep.sum() > 50
        assert not (side.assessment[is_deep] == Assessment.UNCHANGED).any()
        is_cut = side.reasons == NotAssessed.UNEXPLAINED
        assert 10 < is_cut.sum() < is_deep.sum()
        assert np.isnan(side.distances[is_cut]).all()
