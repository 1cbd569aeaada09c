"""What feet say of vertices in one pass, against a slow twin; both sides of a comparison at once or in turn."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import numpy as np
import pytest

from monitor.comparison.distances import side as side_module
from monitor.comparison.distances.judging import NOTHING, Stated, judge_vertices
from monitor.comparison.distances.perpendicular import Feet
from monitor.comparison.distances.side import map_sides, move_surface
from monitor.comparison.distances.smoothing import smooth_distances
from monitor.comparison.distances.stars import gather_neighbours, make_mesh, survey_vertices
from monitor.comparison.regions.enclosure import _lie_within
from projects.model import Floats, NotAssessed, Surface
from projects.transforms import apply, rotation_from_vector

N, N_OTHER, N_FACES = 400, 90, 150


def draw_feet(rng: np.random.Generator) -> tuple[Feet, np.ndarray]:
    """Return feet of N vertices on random faces, some without, and these faces."""
    faces = rng.integers(0, N_OTHER, (N_FACES, 3)).astype(np.int32)
    at = np.where(rng.random(N) < 0.2, -1, rng.integers(0, N_FACES, N)).astype(np.int32)
    weights = rng.dirichlet(np.ones(3), N)
    weights[::9] = 1.0 / 3.0  # alike: the first corner
    reasons = np.where(at < 0, NotAssessed.NO_FACE, NotAssessed.ASSESSED).astype(np.uint8)
    to_rim = np.where(at < 0, np.nan, rng.uniform(0.0, 1.0, N))
    distances = np.where(at < 0, np.nan, rng.normal(size=N))
    return Feet(distances, at, weights, reasons, to_rim), faces


@pytest.mark.parametrize("is_stated", [True, False])
def test_vertices_are_judged_as_a_slow_twin_judges_them(rng: np.random.Generator, is_stated: bool) -> None:
    feet, faces = draw_feet(rng)
    own, other = (Stated(rng.uniform(0.1, 1.0, n), rng.uniform(0.1, 1.0, n)) for n in (N, N_OTHER))
    own.sigma[::50], other.sigma[::30] = np.nan, np.inf
    own_rim, on_nothing, bow = rng.uniform(0.0, 1.0, N), rng.random(N) < 0.1, rng.normal(size=N)
    own_rim[::40] = np.nan
    if not is_stated:
        own, other, own_rim, on_nothing = Stated(NOTHING, NOTHING), Stated(NOTHING, NOTHING), NOTHING, NOTHING > 0.0
    found = judge_vertices(feet, faces, (own, other), bow, own_rim, on_nothing, -1.0, 0.2)
    for v in range(N):
        f, w = feet.faces[v], feet.weights[v]
        sigma = discord = 0.0
        if is_stated:
            there = np.nan if f < 0 else w[0] * other.sigma[faces[f, 0]] + w[2] * other.sigma[faces[f, 2]]
            there += np.nan if f < 0 else w[1] * other.sigma[faces[f, 1]]
            sigma = np.hypot(own.sigma[v], there)
            discord = np.hypot(own.discord[v], 0.0 if f < 0 else w @ other.discord[faces[f]])
        assert found.sigma[v] == sigma or np.isnan([found.sigma[v], sigma]).all()
        assert found.discord[v] == pytest.approx(discord, rel=1e-14)
        rim = np.fmin(feet.to_rim[v], own_rim[v] if is_stated else np.inf)
        assert found.to_rim[v] == rim or np.isnan([found.to_rim[v], rim]).all()
        reason = int(feet.reasons[v])
        if reason == NotAssessed.ASSESSED:
            reason = NotAssessed.TOO_UNCERTAIN if not np.isfinite(sigma) else reason
        if reason == NotAssessed.ASSESSED and rim < 0.2:
            reason = NotAssessed.FREE_EDGE
        if is_stated and on_nothing[v]:
            reason = NotAssessed.NOT_SEEN
        assert found.reasons[v] == reason
        change = -(feet.distances[v] - bow[v]) if reason == NotAssessed.ASSESSED else np.nan
        assert found.distances[v] == change or np.isnan([found.distances[v], change]).all()
        assert found.corners[v] == (-1 if f < 0 else faces[f, np.argmax(w)])
    reasons = {NotAssessed.ASSESSED, NotAssessed.FREE_EDGE, NotAssessed.NO_FACE}
    assert set(found.reasons) == reasons | ({NotAssessed.TOO_UNCERTAIN, NotAssessed.NOT_SEEN} if is_stated else set())


def test_sides_are_worked_on_at_once_where_they_are_small_and_in_turn_where_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(side_module, "AT_ONCE", 100)
    here = threading.get_ident()

    def look(k: int) -> tuple[int, bool]:
        return k, threading.get_ident() == here

    assert map_sides(look, 100) == ((0, False), (1, False))
    assert map_sides(look, 101) == ((0, True), (1, True))
    with pytest.raises(ZeroDivisionError):
        map_sides(lambda k: 1 // k, 100)


def test_surface_moved_in_blocks_is_moved_as_one(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_from_vector(np.array([0.1, -0.7, 0.4])), [3.0, -1.0, 0.5]
    surface = Surface(rng.normal(size=(1003, 3)), np.array([[0, 1, 2]], dtype=np.int32))
    monkeypatch.setattr(side_module, "MOVED_AT_ONCE", 100)
    np.testing.assert_array_equal(move_surface(surface, T).vertices, apply(T, surface.vertices))


def test_faces_within_a_mask_have_all_corners_in_it(rng: np.random.Generator) -> None:
    faces, mask = rng.integers(0, 50, (500, 3)), rng.random(50) < 0.6
    assert np.array_equal(_lie_within(faces, mask), mask[faces].all(axis=1))


def test_stars_tell_neighbours_and_borders_of_any_mesh(rng: np.random.Generator) -> None:
    """Also where edges have three faces or one, and faces have a vertex twice."""
    few = [[40, 43, 41], [40, 41, 42], [40, 42, 41]]  # one edge of 40 has one face, that to the last end; one has three
    faces = np.vstack([rng.integers(0, 40, (90, 3)), few]).astype(np.int32)
    mesh = make_mesh(rng.normal(size=(45, 3)), faces)
    survey, neighbours = survey_vertices(mesh), gather_neighbours(mesh)
    for v in range(45):
        star = [f for f in faces.tolist() if v in f]
        pairs = [sorted((f[k], f[(k + 1) % 3])) for f in star for k in range(3)]
        ends = [b if a == v else a for a, b in pairs if (a == v) != (b == v)]
        assert neighbours.vertices[neighbours.starts[v] : neighbours.starts[v + 1]].tolist() == sorted(set(ends))
        assert survey.n_neighbours[v] == len(set(ends))
        assert survey.is_border[v] == any(ends.count(e) == 1 for e in ends)


def test_a_single_step_of_smoothing_is_the_first_of_many(rng: np.random.Generator) -> None:
    """Where it is the only one the shares are not kept; a slow twin tells what it gives."""
    k = 12
    x, y = (a.ravel() for a in np.meshgrid(np.arange(k), np.arange(k)))
    vertices: Floats = np.column_stack([x, y, rng.normal(0.0, 0.1, k * k)]).astype(float)
    a = np.array([i * k + j for i in range(k - 1) for j in range(k - 1)])
    mesh = make_mesh(
        vertices, np.vstack([np.column_stack([a, a + 1, a + k + 1]), np.column_stack([a, a + k + 1, a + k])])
    )
    near, distances, lod95 = gather_neighbours(mesh), rng.normal(size=k * k), rng.uniform(0.5, 2.0, k * k)
    is_assessed = rng.random(k * k) < 0.9
    distances[~is_assessed] = np.nan
    side = SimpleNamespace(neighbours=near, is_assessed=is_assessed, surface=SimpleNamespace(vertices=vertices),
                           distances=distances, areas=rng.uniform(0.5, 1.0, k * k))  # fmt: skip
    mass = np.where(is_assessed, side.areas, 0.0)
    total = mass * np.nan_to_num(distances)
    counts, expected = np.diff(near.starts), np.full(k * k, np.nan)
    for v in np.flatnonzero(is_assessed):
        here, there, given = 0.0, 0.0, 0.0
        for w in near.vertices[near.starts[v] : near.starts[v + 1]]:
            share = 1.0 / (1.0 + max(counts[v], counts[w]))
            if is_assessed[w]:
                share *= np.exp(-((distances[v] - distances[w]) ** 2) / (lod95[v] ** 2 + lod95[w] ** 2))
            given, here, there = given + share, here + share * mass[w], there + share * total[w]
        expected[v] = (there + (1.0 - given) * total[v]) / (here + (1.0 - given) * mass[v])
    np.testing.assert_allclose(smooth_distances(side, 0.1, lod95), expected, rtol=1e-12)
