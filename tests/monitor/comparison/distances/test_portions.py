"""Surfaces too large for one tree: their pieces tell what one tree of all faces would, to the last bit."""

from __future__ import annotations

import dataclasses
import mmap
from functools import partial

import numpy as np
import pytest
import trimesh
from same_bits import assert_same_bits

from monitor.comparison import compare
from monitor.comparison.distances import both_ways, scratch
from monitor.comparison.distances.portions import PER_TREE, _cut, search_feet, search_offsets
from monitor.comparison.distances.shell import Shell, make_shell
from projects.model import Floats, Registration, Surface

ANGLE = np.pi / 3


def crumpled(rng: np.random.Generator, n: int = 4) -> Surface:
    """Return a rough ball, open below, of radius 1 about (1000, 2000, 0), with a smaller one inside of it."""
    meshes = [trimesh.creation.icosphere(subdivisions=n), trimesh.creation.icosphere(subdivisions=n - 1, radius=0.8)]
    vertices = np.vstack([m.vertices * rng.uniform(0.94, 1.06, (len(m.vertices), 1)) for m in meshes])
    faces = np.vstack([meshes[0].faces, meshes[1].faces[:, ::-1] + len(meshes[0].vertices)])
    faces = faces[(vertices[faces][:, :, 2] > -0.5).all(axis=1)]
    return Surface(vertices + np.array([1000.0, 2000.0, 0.0]), rng.permutation(faces).astype(np.int32))


def both_shells(surface: Surface, limit: float, faces_per_tree: int = 100) -> tuple[Shell, Shell]:
    """Return the shell with one tree and the one without."""
    shift = surface.vertices.mean(axis=0)
    whole, parted = (make_shell(surface, shift, (limit, ANGLE), n) for n in (10**9, faces_per_tree))
    assert whole.tree is not None
    assert parted.tree is None
    return whole, parted


def places_around(surface: Surface, rng: np.random.Generator, n: int = 3000) -> tuple[Floats, Floats]:
    """Return points (n, 3) about the surface and directions that they look in; some at its vertices, some far away."""
    start = surface.vertices[rng.integers(0, len(surface.vertices), n)]
    points = start + rng.normal(size=(n, 3)) * rng.choice([0.0, 0.01, 0.1, 1.0], (n, 1))
    looks = rng.normal(size=(n, 3)) * 0.5 + (start - surface.vertices.mean(axis=0))
    return points, looks / np.linalg.norm(looks, axis=1)[:, None]


@pytest.mark.parametrize("limit", [0.05, 0.5])
def test_pieces_find_the_feet_that_one_tree_finds(rng: np.random.Generator, limit: float) -> None:
    whole, parted = both_shells(crumpled(rng), limit)
    places = places_around(whole.surface, rng)
    wanted, found = search_feet(whole, *places), search_feet(parted, *places)
    assert len(np.unique(wanted[3])) >= 4  # feet, borders, other sheets or none: all are met
    for one, other in zip(wanted, found, strict=True):
        np.testing.assert_array_equal(one, other)


def test_pieces_find_the_nearest_points_that_one_tree_finds(rng: np.random.Generator) -> None:
    whole, parted = both_shells(crumpled(rng), 0.1)
    points = np.vstack([places_around(whole.surface, rng)[0], whole.surface.vertices[:1] + np.array([30.0, 0.0, 0.0])])
    found = search_offsets(parted, points)
    for one, other in zip(search_offsets(whole, points), found, strict=True):
        np.testing.assert_array_equal(one, other)
    assert (found.faces >= 0).all()
    assert not len(search_offsets(parted, points[:0]).faces)


def test_of_points_equally_near_two_faces_pieces_take_the_one_that_one_tree_takes() -> None:
    x, y = (a.ravel() for a in np.meshgrid(np.arange(40.0), np.arange(40.0), indexing="ij"))
    i, j = (a.ravel() for a in np.meshgrid(np.arange(39), np.arange(39), indexing="ij"))
    a = i * 40 + j
    faces = np.vstack([np.column_stack([a, a + 40, a + 41]), np.column_stack([a, a + 41, a + 1])])
    sheet = Surface(np.column_stack([x, y, np.zeros(1600)]), faces)
    whole, parted = both_shells(sheet, 3.0)
    points = sheet.vertices + np.array([0.0, 0.0, 0.5])  # over vertices: six faces are as near
    looks = np.tile([0.0, 0.0, 1.0], (1600, 1))
    for one, other in zip(search_feet(whole, points, looks), search_feet(parted, points, looks), strict=True):
        np.testing.assert_array_equal(one, other)


def test_boxes_are_as_few_as_take_least() -> None:
    """Points all over a sheet, nearer to each other than they reach, want all of its faces once, not each its own;
    points in two of its corners want the faces there."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(300.0), np.arange(300.0), indexing="ij"))
    i, j = (a.ravel() for a in np.meshgrid(np.arange(299), np.arange(299), indexing="ij"))
    a = i * 300 + j
    faces = np.vstack([np.column_stack([a, a + 300, a + 301]), np.column_stack([a, a + 301, a + 1])])
    sheet = Surface(np.column_stack([x, y, np.zeros(90_000)]), faces)
    shell = both_shells(sheet, 30.0, len(faces) - 1)[1]
    scattered = np.random.default_rng(4).uniform(0.0, 299.0, (120, 3)) * [1.0, 1.0, 0.0]
    asked = [len(numbers) for _, numbers in _cut(shell, scattered, np.arange(120), 30.0)]
    assert len(faces) <= sum(asked) + PER_TREE * len(asked) < 1.5 * len(faces)
    corners = np.array([[1.0, 1.0, 0.0], [298.0, 298.0, 0.0]])
    asked = [len(numbers) for _, numbers in _cut(shell, corners, np.arange(2), 30.0)]
    assert len(asked) == 2
    assert sum(asked) < 5000  # 31 x 31 fields of two faces each, twice


def test_a_comparison_by_pieces_and_on_disk_is_that_by_one_tree_in_memory(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    reference = crumpled(rng)
    depth = 0.1 * np.exp(-((np.linalg.norm(reference.vertices - [1001.0, 2000.0, 0.0], axis=1) / 0.3) ** 2))
    moved = reference.vertices - depth[:, None] * [1.0, 0.0, 0.0] + rng.normal(0.0, 1e-4, reference.vertices.shape)
    compared = dataclasses.replace(reference, vertices=moved)
    registration = Registration(np.eye(4), np.eye(6) * 1e-12, reference.vertices.mean(axis=0), True)
    whole = compare(reference, compared, registration)
    monkeypatch.setattr(both_ways, "make_shell", partial(make_shell, faces_per_tree=100))
    monkeypatch.setattr(scratch, "LEAST", 1)
    assert_same_bits(compare(reference, compared, registration), whole)


def test_what_is_kept_on_disk_stays_as_it_is_and_can_be_written(rng: np.random.Generator) -> None:
    values = rng.normal(size=(scratch.LEAST // 24 + 1, 3))[:, ::-1]
    kept = scratch.keep_on_disk(values)
    assert isinstance(kept.base.base.obj, mmap.mmap)
    np.testing.assert_array_equal(kept, values)
    assert kept.flags.c_contiguous
    kept[0] = 7.0
    assert values[0, 0] != 7.0
    assert scratch.keep_on_disk(values[:5]).base is values.base


def test_where_the_disk_is_full_numbers_stay_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(scratch, "LEAST", 1)
    monkeypatch.setattr(scratch.tempfile, "TemporaryFile", refuse)
    values = np.arange(9.0)
    assert scratch.keep_on_disk(values) is values
