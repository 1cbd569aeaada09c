"""Cracks narrower than a surface follows are told by the points in them, and what only looks like one is not."""

from __future__ import annotations

import numpy as np
import pytest

from monitor.comparison import compare
from projects.model import Comparison, Floats, NotAssessed, Registration, Surface

SPACING, NOISE = 2e-3, 5e-5  # m
SIZE, WIDTH, LENGTH, DEPTH = 0.2, 4e-3, 0.12, 0.03  # m
STILL = Registration(np.eye(4), np.diag([1e-6, 1e-6, 1e-6, 1e-5, 1e-5, 1e-5]) ** 2, np.zeros(3), True)


def height(points: Floats) -> Floats:
    return 0.001 * np.sin(points[:, 0] / 0.03) * np.cos(points[:, 1] / 0.04)


def is_in_mouth(points: Floats) -> np.ndarray:
    return (np.abs(points[:, 0]) < WIDTH / 2) & (np.abs(points[:, 1]) < LENGTH / 2)


def sheet(rng: np.random.Generator, sag: float = 0.0) -> Surface:
    """Return a wavy sheet, its mouth of the crack bridged `sag` [m] below."""
    x, y = (a.ravel() for a in np.meshgrid(*[np.arange(-SIZE / 2, SIZE / 2, SPACING)] * 2, indexing="ij"))
    n = round(np.sqrt(len(x)))
    i = np.arange(len(x)).reshape(n, n)
    a, b, c, d = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
    flat = np.column_stack([x, y])
    z = height(flat) + rng.normal(0.0, NOISE, len(x)) - sag * is_in_mouth(flat)
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return Surface(np.column_stack([x, y, z]), faces, sigma=np.full(len(x), NOISE))


def measured(rng: np.random.Generator, n: int = 40_000) -> Floats:
    """Return points on the whole sheet."""
    flat = rng.uniform(-SIZE / 2, SIZE / 2, (n, 2))
    return np.column_stack([flat, height(flat) + rng.normal(0.0, NOISE, n)])


def sunk(rng: np.random.Generator, points: Floats, share: float = 1.0) -> Floats:
    """Return points of which those over the crack, or a share of them, went in: as deep as its walls and ground."""
    out = points.copy()
    goes_in = is_in_mouth(points) & (rng.random(len(points)) < share)
    out[goes_in, 2] -= np.minimum(rng.uniform(0.0, 1.6 * DEPTH, goes_in.sum()), DEPTH)
    return out


def compared(before: Surface, after: Surface, points: tuple[Floats, Floats]) -> Comparison:
    return compare(before, after, STILL, points=lambda: points)


def test_a_crack_that_a_surface_bridges_is_told_by_the_points_in_it(rng: np.random.Generator) -> None:
    found = compared(sheet(rng), sheet(rng, 1e-3), (measured(rng), sunk(rng, measured(rng))))
    (region,) = found.regions.to_dict("records")
    assert region["kind"] == "lost"
    assert region["area_m2"] == pytest.approx(WIDTH * LENGTH, rel=0.35)
    assert region["extreme_m"] == pytest.approx(-DEPTH, rel=0.05)
    assert np.isnan(
        [region[name] for name in ("volume_m3", "sigma_volume_m3", "sigma_extreme_m", "sigma_mean_m")]
    ).all()
    assert [shape["is_hollow"] for shape in found.statistics["region_shapes"]] == [True]
    before, after = found.on_reference, found.on_compared
    mouth = is_in_mouth(before.surface.vertices)
    inner = mouth & (np.abs(before.surface.vertices[:, 0]) < 0.25 * WIDTH)
    assert (before.reasons[inner] == NotAssessed.LOOKED_THROUGH).mean() > 0.8
    assert (before.distances[before.reasons == NotAssessed.LOOKED_THROUGH] < -0.004).all()
    assert (after.reasons[inner] != NotAssessed.ASSESSED).mean() > 0.8  # the same grid
    assert not before.is_changed[~mouth & (np.abs(before.surface.vertices[:, 0]) > WIDTH)].any()


def test_walls_of_a_hollow_do_not_widen_its_mouth(rng: np.random.Generator) -> None:
    """Beams that come aslant meet the walls many times more often than the wall's face beside the mouth."""
    half, n = 5e-3, 6000
    walls = np.column_stack([rng.choice([-half, half], n), rng.uniform(-LENGTH / 2, LENGTH / 2, n), np.zeros(n)])
    walls[:, 2] = height(walls) - rng.uniform(0.0, DEPTH, n)
    before, after = measured(rng), measured(rng)
    after[:, 2] -= DEPTH * ((np.abs(after[:, 0]) < half) & (np.abs(after[:, 1]) < LENGTH / 2))
    found = compared(sheet(rng), sheet(rng, 1e-3), (before, np.concatenate([after, walls])))
    (region,) = found.regions.to_dict("records")
    assert region["area_m2"] == pytest.approx(2.0 * half * LENGTH, rel=0.15)


def test_a_crack_that_was_filled_is_added(rng: np.random.Generator) -> None:
    found = compared(sheet(rng, 1e-3), sheet(rng), (sunk(rng, measured(rng)), measured(rng)))
    (region,) = found.regions.to_dict("records")
    assert region["kind"] == "added"
    assert region["extreme_m"] == pytest.approx(DEPTH, rel=0.05)


def test_a_crack_that_both_epochs_looked_into_is_none(rng: np.random.Generator) -> None:
    found = compared(sheet(rng), sheet(rng, 1e-3), (sunk(rng, measured(rng), 0.3), sunk(rng, measured(rng))))
    assert not (found.on_reference.reasons == NotAssessed.LOOKED_THROUGH).any()


def test_a_gap_that_one_epoch_bridged_and_the_other_looked_into_is_none(rng: np.random.Generator) -> None:
    """Its own points tell that the first surface measured nothing there."""
    before = measured(rng)
    found = compared(sheet(rng), sheet(rng, 1e-3), (before[~is_in_mouth(before)], sunk(rng, measured(rng))))
    assert not len(found.regions)


def test_strays_behind_a_surface_are_no_hollow(rng: np.random.Generator) -> None:
    after = measured(rng)
    strays = after[rng.integers(0, len(after), 200)] - [0.0, 0.0, 0.02]
    found = compared(sheet(rng), sheet(rng, 1e-3), (measured(rng), np.concatenate([after, strays])))
    assert not len(found.regions)


def test_the_back_of_what_was_the_front_is_no_hollow(rng: np.random.Generator) -> None:
    """A board 2 cm thick, a strip of whose front one epoch did not see, and of whose back the other."""
    front, back = measured(rng), measured(rng) - [0.0, 0.0, 0.02]
    hidden = is_in_mouth(front)
    behind = sheet(rng)
    far_side = Surface(behind.vertices - [0.0, 0.0, 0.02], behind.faces[:, ::-1], sigma=behind.sigma)
    own = sheet(rng, 1e-3)
    both = Surface(np.concatenate([own.vertices, far_side.vertices]),
                   np.concatenate([own.faces, far_side.faces + len(own.vertices)]),
                   sigma=np.concatenate([own.sigma, far_side.sigma]))  # fmt: skip
    found = compared(sheet(rng), both, (measured(rng), np.concatenate([front[~hidden], back])))
    assert not (found.regions["kind"] == "lost").any()
