"""What neighbourhoods share in error, stated anew against what the registration of two epochs holds to."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import block_diag

from monitor import held_placement
from monitor.held_placement import place_against_held
from monitor.registration.network.placement import lay_out_placement, placement_sigma
from projects.model import Floats, Ints, PointCloud, Registration, Surface

EDGE, LONG, HIGH = 0.02, 151, 51  # of the walls: m, vertices along y and z
REST = 3e-4  # m, what the scans of either epoch disagree by
T = np.array([[1.0, 0.0, 0.0, 0.2], [0.0, 1.0, 0.0, -5.0], [0.0, 0.0, 1.0, 0.1], [0.0, 0.0, 0.0, 1.0]])


def wall_of_three_scans(rng: np.random.Generator) -> tuple[Surface, Any]:
    """Return a wall 3 m long across x, and where its three scans stand, side by side, each to 1 mm along x."""
    y, z = (g.ravel() for g in np.meshgrid(EDGE * np.arange(LONG) - 1.5, EDGE * np.arange(HIGH) - 0.5, indexing="ij"))
    i = np.arange((LONG - 1) * HIGH).reshape(LONG - 1, HIGH)[:, :-1].ravel()
    faces = np.vstack([np.c_[i, i + HIGH, i + 1], np.c_[i + 1, i + HIGH, i + HIGH + 1]])
    clouds = []
    for low in (-1.5, -0.5, 0.5):
        points = np.c_[np.zeros(4000), rng.uniform(low, low + 1.0, 4000), rng.uniform(-0.5, 0.5, 4000)]
        clouds.append(PointCloud(points, normals=np.tile([1.0, 0.0, 0.0], (4000, 1))))
    along_x = np.zeros((6, 6))
    along_x[3, 3] = 1e-6
    placement = lay_out_placement(clouds, 0.01, block_diag(*[along_x] * 3), np.zeros((3, 3)))
    surface = Surface(np.c_[np.zeros(len(y)), y, z], faces)
    shared = np.hypot(placement_sigma(surface.vertices, placement), REST)
    return Surface(surface.vertices, faces, sigma=np.full(len(y), 1e-4), sigma_shared=shared), placement


def registration(weights: Floats | None) -> Registration:
    return Registration(T, np.zeros((6, 6)), np.zeros(3), True, weights=weights)


def split_faces(surface: Surface, which: Ints) -> tuple[Floats, Ints]:
    """Return vertices and faces with a vertex more in the middle of each face `which`."""
    corners = surface.faces[which]
    new = len(surface.vertices) + np.arange(len(which))
    rest = np.delete(surface.faces, which, axis=0)
    parts = [np.c_[corners[:, a], corners[:, b], new] for a, b in ((0, 1), (1, 2), (2, 0))]
    return np.vstack([surface.vertices, surface.vertices[corners].mean(axis=1)]), np.vstack([rest, *parts])


@pytest.fixture
def epochs(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> tuple[Surface, Surface]:
    """The wall in two epochs, the later one elsewhere."""
    reference, placement = wall_of_three_scans(rng)
    monkeypatch.setattr(held_placement, "_placement", lambda place: placement)
    return reference, reference


def test_a_part_left_out_is_as_sure_as_its_scan_against_the_others(
    epochs: tuple[Surface, Surface], monkeypatch: pytest.MonkeyPatch
) -> None:
    reference, same = epochs
    moved = Surface(same.vertices - T[:3, 3], same.faces, sigma=same.sigma, sigma_shared=same.sigma_shared)
    here = held_placement._placement(None)  # type: ignore[arg-type]
    assert here is not None
    there = replace(here, middles=here.middles - T[:3, 3])
    monkeypatch.setattr(held_placement, "_placement", lambda place: here if place == "before" else there)
    held = np.where(same.vertices[:, 1] < 0.5, 1.0, 0.0)
    told = place_against_held(("before", "after"), (reference, moved), registration(held))  # type: ignore[arg-type]
    for surface in told:
        assert surface.sigma_shared is not None
        middle = np.abs(same.vertices[:, 1] - 1.0) < 0.1
        third = np.sqrt((1.0 + 1.625**2 + 0.625**2) * 1e-6 + REST**2)  # as in test_placement
        assert np.median(surface.sigma_shared[middle]) == pytest.approx(third, rel=0.05)
        assert (surface.sigma_shared >= 0.95 * REST).all()
        first = np.abs(same.vertices[:, 1] + 1.0) < 0.1
        assert np.median(surface.sigma_shared[first]) < 0.6e-3


def test_what_nobody_knows_stays_unknown(epochs: tuple[Surface, Surface]) -> None:
    reference, compared = epochs
    assert reference.sigma_shared is not None
    unknown = np.where(np.arange(len(reference.vertices)) % 2, reference.sigma_shared, np.nan)
    reference = Surface(reference.vertices, reference.faces, sigma=reference.sigma, sigma_shared=unknown)
    held = np.where(np.arange(len(unknown)) % 7 > 0, 1.0, 0.0)
    told, _ = place_against_held(("a", "b"), (reference, compared), registration(held))  # type: ignore[arg-type]
    assert told.sigma_shared is not None
    assert np.array_equal(np.isnan(told.sigma_shared), np.isnan(unknown))


@pytest.mark.parametrize("weight", [None, 0.0])
def test_nothing_is_told_anew_where_the_registration_holds_to_nothing(
    epochs: tuple[Surface, Surface], weight: float | None
) -> None:
    known = registration(None if weight is None else np.full(len(epochs[1].vertices), weight))
    told = place_against_held(("a", "b"), epochs, known)  # type: ignore[arg-type]
    assert told[0] is epochs[0]
    assert told[1] is epochs[1]


def test_about_all_alike_is_as_the_epoch_alone_states_it(epochs: tuple[Surface, Surface]) -> None:
    alike = np.full(len(epochs[1].vertices), 1.0 / len(epochs[1].vertices))
    told = place_against_held(("a", "b"), epochs, replace(registration(alike), T_target_source=np.eye(4)))  # type: ignore[arg-type]
    for surface in told:
        assert surface is not epochs[0]
        assert surface.sigma_shared == pytest.approx(epochs[0].sigma_shared, rel=0.02)


def test_weights_go_over_to_a_reference_of_other_vertices(epochs: tuple[Surface, Surface]) -> None:
    """The reference has twice as many vertices on one half, and a sliver: neither weighs more for that."""
    reference, compared = epochs
    half = np.flatnonzero(reference.vertices[reference.faces].mean(axis=1)[:, 1] > 0.0)
    more, faces = split_faces(reference, half)
    more[-1] = more[faces[-1, 0]] + [0.0, 1e-9, 0.0]  # next to a corner of its face
    alike = np.full(len(compared.vertices), 1.0 / len(compared.vertices))
    here = replace(registration(alike), T_target_source=np.eye(4))
    on = held_placement._weights_on(Surface(more, faces), compared, alike, here)
    assert on.sum() == pytest.approx(1.0)
    assert on[more[:, 1] > 0.0].sum() == pytest.approx(0.5, rel=0.02)
    assert on.max() <= 2.0 * alike[0]
    swapped = held_placement._weights_on(compared, Surface(more, faces), np.full(len(more), 1.0 / len(more)), here)
    assert swapped.sum() == pytest.approx(1.0)
    assert swapped.max() <= 8.0 / len(more)
    far = replace(here, T_target_source=T)
    assert held_placement._weights_on(reference, compared, alike, far).sum() == 0.0


def test_an_epoch_without_an_adjustment_stays_as_it_is(
    epochs: tuple[Surface, Surface], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(held_placement, "_placement", lambda place: None)
    held = np.where(epochs[1].vertices[:, 1] < 0.5, 1.0, 0.0)
    told = place_against_held(("a", "b"), epochs, registration(held))  # type: ignore[arg-type]
    assert told[0] is epochs[0]
    assert told[1] is epochs[1]
