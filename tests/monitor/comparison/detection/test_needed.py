"""How large a change must be to be told: the test of patches turned around, and held against changes that are made."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from monitor.comparison import compare
from monitor.comparison.detection.needed import POWER, by_width, needed
from monitor.comparison.detection.patches import REACHES
from monitor.comparison.noise.patch_errors import NORMAL, PatchErrors
from projects.model import Bools, Comparison, Floats, Registration, Surface

N, EDGE, NOISE = 141, 2e-3, 5e-5  # vertices along a sheet; m


@pytest.mark.parametrize("dofs", [(NORMAL, NORMAL), (4.0, 12.0)])
def test_what_a_patch_needs_has_the_p_value_asked_for(dofs: tuple[float, float]) -> None:
    errors, kinds = PatchErrors(np.array([1.0, 1.7]), np.array(dofs)), np.array([0, 1, 1])
    known = np.array([NORMAL, NORMAL, 9.0])  # degrees of freedom of their sigmas
    z = errors.needed(kinds, known, 2e-6, 0.0)
    assert errors.p_values(z, kinds, known) == pytest.approx(np.full(3, 2e-6), rel=1e-5)
    assert errors.needed(kinds, known, 2e-6, 2.0) - z == pytest.approx([2.0, 3.4, 3.4])
    assert z[2] > 1.25 * z[1]  # fewer degrees of freedom than the errors of its kind have


def test_a_patch_needs_so_many_of_its_sigmas_and_a_scrap_is_not_tested() -> None:
    patches = cast(Any, SimpleNamespace(sigmas=np.array([[1.0, 0.5], [2.0, 3.0]]), kinds=np.array([0, 1]),
                                        dofs=np.full((2, 2), NORMAL),
                                        is_whole=np.array([[True, True], [True, False]])))  # fmt: skip
    errors = PatchErrors(np.array([1.0, 2.0]), np.full(2, NORMAL))
    found = needed(patches, (errors, errors), 0.05)
    assert found[0] == pytest.approx([1.96 + 1.645, 0.5 * (1.96 + 1.645)], abs=2e-3)
    assert found[1, 0] == pytest.approx(2.0 * 2.0 * (1.96 + 1.645), abs=5e-3)
    assert np.isnan(found[1, 1])
    assert pytest.approx(1.645, abs=1e-3) == POWER


def test_a_wider_change_needs_no_more_than_the_narrower_one_that_it_holds() -> None:
    first, second = (
        np.array([[3.0, 1.0, np.nan], [5.0, np.nan, np.nan]]),
        np.array([[4.0, 2.0, np.nan], [9.0, 9.0, 7.0]]),
    )
    found = by_width((first, second), 0.01)
    assert found[:, 0] == pytest.approx([0.02 * (r + np.sqrt(2.0)) for r in REACHES[:3]])
    assert found[:, 1] == pytest.approx([4.5, 2.0, 2.0])
    assert np.isnan(by_width((np.full((2, 1), np.nan),) * 2, 0.01)[0, 1])


@pytest.mark.parametrize("size", range(3))
def test_a_change_as_wide_holds_a_whole_patch_of_square_units_wherever_it_lies(size: int) -> None:
    rng, needs = np.random.default_rng(size), np.ones((2, 3))
    reach, width = REACHES[size], by_width((needs, needs), 1.0)[size, 0]
    centres = np.stack(np.meshgrid(np.arange(-12, 13), np.arange(-12, 13)), axis=-1).reshape(-1, 2)
    corners = 0.5 * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])

    def holds_one(middle: Floats, width: float) -> bool:
        """Whether a disc holds all units of a patch."""
        around = centres[np.argsort(np.linalg.norm(centres - middle, axis=1))[:4]]
        patches = (centres[np.linalg.norm(centres - c, axis=1) <= reach] for c in around)
        return any(np.linalg.norm(p[:, None] + corners - middle, axis=2).max() <= 0.5 * width for p in patches)

    middles = np.vstack([rng.uniform(-0.5, 0.5, (300, 2)), [[0.5, 0.5]]])
    assert all(holds_one(m, width + 1e-9) for m in middles)
    assert not all(holds_one(m, 2.0 * reach + (1.0 if size else 2.0)) for m in middles)  # as was said before


def sheet(heights: Floats, noise: float | None = NOISE, shared: Floats | None = None) -> Surface:
    """Return a sheet of these heights (N, N) [m], which states its noise [m], or none, and what its scans disagree by
    (N, N) [m]."""
    i = np.arange((N - 1) * N).reshape(N - 1, N)[:, :-1].ravel()
    faces = np.vstack([np.c_[i, i + N, i + 1], np.c_[i + 1, i + N, i + N + 1]])
    x, y = np.divmod(np.arange(N * N), N)
    return Surface(
        np.c_[EDGE * x, EDGE * y, heights.ravel()], faces, sigma=None if noise is None else np.full(N * N, noise),
        sigma_shared=None if shared is None else shared.ravel(),
    )  # fmt: skip


def compared(
    rng: np.random.Generator, change: Floats, noise: float | None = NOISE, shared: Floats | None = None
) -> Comparison:
    """Compare two sheets that differ by noise and a change (N, N) [m], and state the `noise` [m] and what the scans of
    each disagree by (N, N) [m]."""
    fixed = Registration(np.eye(4), np.diag([1e-7] * 3 + [1e-8] * 3) ** 2, np.zeros(3), True, stable_share=1.0,
                         is_stable=np.ones(N * N, dtype=bool))  # fmt: skip
    first, second = (sheet(rng.normal(scale=NOISE, size=(N, N)) + c, noise, shared) for c in (np.zeros((N, N)), change))
    return compare(first, second, fixed)


def squares(rng: np.random.Generator, width: float) -> list[Bools]:
    """Return nine squares (N, N) so wide [m], each anywhere in its ninth of the sheet."""
    out, n = [], round(width / EDGE)
    for i, j in np.ndindex(3, 3):
        a, b = (47 * k + 4 + rng.integers(0, 47 - 8 - n) for k in (i, j))
        out.append(np.zeros((N, N), dtype=bool))
        out[-1][a : a + n, b : b + n] = True
    return out


def test_of_finished_meshes_it_is_not_known(rng: np.random.Generator) -> None:
    found = compared(rng, np.zeros((N, N)), None)
    assert np.isnan(np.array(found.statistics["told_by_width_m"])[:, 1]).all()
    assert found.on_compared.told_from is not None
    assert np.isnan(found.on_compared.told_from).all()
    assert np.isnan(found.statistics["told_from_median_m"])


@pytest.mark.parametrize(("share", "least", "most"), [(1.0, 0.85, 1.0), (0.6, 0.0, 0.4)])
def test_changes_of_the_size_given_are_told_and_smaller_ones_are_not(
    rng: np.random.Generator, share: float, least: float, most: float
) -> None:
    """A region lies there, though a faint change falls to pieces."""
    statistics = compared(rng, np.zeros((N, N))).statistics
    width, depth = statistics["told_by_width_m"][0]
    assert statistics["told_from_median_m"] == pytest.approx(depth, rel=0.01)
    n_told, n = 0, 0
    for _ in range(3):
        places = squares(rng, width)
        found = compared(rng, -share * depth * np.sum(places, axis=0)).on_compared
        n_told += sum(found.is_changed[place.ravel()].mean() > 0.2 for place in places)
        n += len(places)
    assert least <= n_told / n <= most, (n_told, width, depth, statistics["lod95_median_m"])


STATED = np.full((N, N), 1e-4)  # m, what scans disagree by


def discs(n: int, radius: float) -> Floats:
    """Return how many of `n` discs of a radius [m] each place (N, N) lies in: on a grid, none near a border."""
    x, y = np.mgrid[:N, :N]
    middles = [(24 + 46 * i, 24 + 46 * j) for i, j in np.ndindex(3, 3)][:n]
    return np.sum([np.hypot(x - i, y - j) < radius / EDGE for i, j in middles], axis=0, initial=0)


def told(found: Comparison) -> float:
    """Return from how large a change [m] on one is told, of the narrowest that is."""
    return float(found.statistics["told_by_width_m"][0][1])


def test_scans_that_err_alike_in_both_epochs_let_smaller_changes_be_told(rng: np.random.Generator) -> None:
    """Stated is 0.14 mm of the change, of which patches show nothing; a quarter of it counts."""
    still, alone = compared(rng, np.zeros((N, N)), shared=STATED), compared(rng, np.zeros((N, N)))
    assert still.statistics["error_scales_scans"] == pytest.approx([0.28], abs=0.01)
    assert alone.statistics["error_scales_scans"] == []
    assert told(alone) < told(still) < 4e-4  # 0.9 mm as stated
    found = compared(rng, -5e-4 * discs(1, 0.018), shared=STATED)
    assert list(found.regions["kind"]) == ["cleaned"]
    assert found.regions["sigma_mean_m"][0] < 0.5e-4
    assert found.regions["extreme_m"][0] == pytest.approx(-5e-4, abs=1.5e-4)
    bare = compared(rng, -5e-4 * discs(1, 0.018))
    sigmas = [f.regions["sigma_volume_m3"][0] / f.regions["area_m2"][0] for f in (found, bare)]
    assert 1.2 * sigmas[1] < sigmas[0] < 1e-4


def test_what_scans_really_err_by_is_no_region_and_lets_only_larger_changes_be_told(rng: np.random.Generator) -> None:
    x, y = np.divmod(np.arange(N * N), N)
    waves = [np.sin(2.0 * np.pi * (i * x + j * y) / N + rng.uniform(0.0, 6.0)) for i, j in np.ndindex(7, 7)]
    err = np.tensordot(rng.normal(size=len(waves)), np.array(waves), 1).reshape(N, N)
    found = compared(rng, 2.2e-4 * err / err.std(), shared=STATED)
    assert len(found.regions) == 0
    assert told(found) > 1e-3  # 0.34 mm where they err alike in both epochs


def test_changes_that_are_found_do_not_pass_for_errors_of_scans(rng: np.random.Generator) -> None:
    """Wide patches beside them hold a part of them: the scale was a half and more, and a fifth one was lost."""
    still = compared(rng, np.zeros((N, N)), shared=STATED)
    found = compared(rng, -2e-3 * discs(4, 0.018), shared=STATED)
    assert len(found.regions) == 4
    assert told(found) == pytest.approx(told(still), rel=0.1)


def test_few_places_that_state_more_and_err_by_it_are_no_regions(rng: np.random.Generator) -> None:
    """Thirteen of a hundred had one while what most places show was believed of them too."""
    stated, n_false = np.where(discs(5, 0.012) > 0, 3e-4, STATED), 0
    each = [discs(k + 1, 0.012) - discs(k, 0.012) for k in range(5)]
    for _ in range(24):
        err = sum(rng.normal(scale=3e-4 * np.sqrt(2.0)) * spot for spot in each)
        n_false += len(compared(rng, err, shared=stated).regions) > 0
    assert n_false <= 1
