"""Distances of vertices to another surface: exact geometry, a slow twin, and what is not assessable."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh

from monitor.comparison.distances import packets
from monitor.comparison.distances.feet import FOOT, find_feet
from monitor.comparison.distances.mesh_tree import build_tree
from monitor.comparison.distances.perpendicular import Feet, interpolate_at_feet, normal_distances
from monitor.comparison.distances.search import ANY, DEPTH, LOOKING, STANDING, nearest_point
from monitor.comparison.distances.stars import angle_weighted_normals, make_mesh
from monitor.comparison.distances.triangles import FACE
from monitor.morton import point_order
from projects.errors import ComparisonError, ParameterError
from projects.model import Floats, NotAssessed, Surface
from projects.transforms import rotation_from_vector

LIMIT = 0.5


def square(n: int = 2, size: float = 1.0, height: float = 0.0) -> Surface:
    """Return a horizontal square of n x n vertices, corner at the origin, looking up."""
    x, y = np.meshgrid(np.linspace(0, size, n), np.linspace(0, size, n), indexing="ij")
    i, j = np.meshgrid(np.arange(n - 1), np.arange(n - 1), indexing="ij")
    a = (i * n + j).ravel()
    faces = np.vstack([np.column_stack([a, a + n, a + n + 1]), np.column_stack([a, a + n + 1, a + 1])])
    return Surface(np.column_stack([x.ravel(), y.ravel(), np.full(n * n, height)]), faces)


def points_looking(points: Floats, looks: Floats) -> Surface:
    """Return a surface whose first vertices are these points with these normals (its one face is far away)."""
    points, looks = np.atleast_2d(points).astype(float), np.atleast_2d(looks).astype(float)
    far = np.array([[50.0, 0, 0], [51.0, 0, 0], [50.0, 1, 0]])
    looks = looks / np.linalg.norm(looks, axis=1, keepdims=True)
    n = len(points)
    return Surface(np.vstack([points, far]), [[n, n + 1, n + 2]], normals=np.vstack([looks, np.eye(3)]))


def measure(points: Floats, looks: Floats, other: Surface, limit: float = LIMIT) -> Feet:
    """Return the feet of points that look somewhere."""
    feet = normal_distances(points_looking(points, looks), other, limit)
    n = len(np.atleast_2d(points))
    return Feet(*(getattr(feet, f.name)[:n] for f in dataclasses.fields(feet)))


def cube() -> Surface:
    mesh = trimesh.creation.box((1.0, 1.0, 1.0))
    return Surface(mesh.vertices, mesh.faces)


def test_point_above_plane_has_positive_distance_and_below_negative() -> None:
    feet = measure([[0.3, 0.4, 0.02], [0.3, 0.4, -0.02]], [[0, 0, 1], [0, 0, 1]], square())
    np.testing.assert_allclose(feet.distances, [0.02, -0.02], rtol=1e-14)
    assert (feet.reasons == NotAssessed.ASSESSED).all()


def test_foot_weights_give_the_foot_back(rng: np.random.Generator) -> None:
    points = np.column_stack([rng.uniform(0.1, 0.9, (50, 2)), rng.uniform(-0.1, 0.1, 50)])
    other = square(5)
    feet = measure(points, np.tile([0, 0, 1.0], (50, 1)), other)
    foot = np.column_stack([interpolate_at_feet(other.vertices[:, k], other, feet) for k in range(3)])
    np.testing.assert_allclose(foot, points * [1, 1, 0], atol=1e-15)


@pytest.mark.parametrize(
    ("point", "looks", "distance"),
    [
        ([0.6, 0.1, 0.2], [1, 0, 0], 0.1),  # over a face
        ([0.4, 0.1, 0.2], [1, 0, 0], -0.1),  # under it
        ([0.53, 0.54, 0.2], [1, 1, 0], 0.05),  # outside an edge: sign of the pseudo-normal
        ([0.52, 0.52, 0.52], [1, 1, 1], np.sqrt(3) * 0.02),  # outside a corner
        ([0.48, 0.46, 0.2], [1, 1, 0], -0.02),  # inside an edge: the nearer face
        ([0.48, 0.40, 0.2], [0, 1, 0], -0.10),  # inside an edge, but looking at the other face
    ],
)
def test_cube_distances_are_exact(point: list[float], looks: list[float], distance: float) -> None:
    feet = measure(point, looks, cube())
    assert feet.reasons[0] == NotAssessed.ASSESSED
    assert feet.distances[0] == pytest.approx(distance, rel=1e-12)


def test_corner_sign_does_not_depend_on_how_the_sides_are_cut() -> None:
    corner = np.array([0.5, 0.5, 0.5])
    directions = np.array([[1, 0.05, 0.05], [0.05, 1, 0.05], [0.05, 0.05, 1], [1, 1, 0.05]])
    feet = measure(corner + 0.05 * directions, [[1, 0.8, 0.8], [0.8, 1, 0.8], [0.8, 0.8, 1], [1, 1, 0.8]], cube())
    np.testing.assert_allclose(feet.distances, 0.05 * np.linalg.norm(directions, axis=1), rtol=1e-12)


def test_before_a_sharp_edge_the_nearest_faces_own_normal_would_lie() -> None:
    half = np.tan(np.radians(10.0))  # a wedge of 20 degrees along y, its edge towards +x
    vertices = np.array([[x, y, z] for x, z in ((0.0, 0.0), (-1.0, half), (-1.0, -half)) for y in (-1.0, 1.0)])
    wedge = Surface(vertices, [[0, 1, 3], [0, 3, 2], [0, 5, 1], [0, 4, 5]])
    feet = measure([[0.1, 0.3, -0.05]], [[0.7, 0.0, 0.7]], wedge)  # looks like the upper face, stands lower
    assert feet.distances[0] == pytest.approx(np.hypot(0.1, 0.05), rel=1e-12)


def test_before_a_sharp_corner_the_nearest_faces_own_normal_would_lie() -> None:
    base = [[-1.0, 0.2, 0.2], [-1.0, -0.2, 0.2], [-1.0, -0.2, -0.2], [-1.0, 0.2, -0.2]]
    spike = Surface(np.array([[0.0, 0.0, 0.0], *base]), [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1],
                                                         [1, 3, 2], [1, 4, 3]])  # fmt: skip
    feet = measure([[0.1, 0.0, -0.05]], [[0.7, 0.0, 0.7]], spike)
    assert feet.distances[0] == pytest.approx(np.hypot(0.1, 0.05), rel=1e-12)


def test_sphere_distance_is_radial_to_the_sagitta() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    sphere = Surface(mesh.vertices, mesh.faces)
    edge = float(mesh.edges_unique_length.max())
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    for radius in (0.9, 1.1):
        feet = measure(radius * directions, directions, sphere)
        assert (feet.reasons == 0).all()
        error = feet.distances - (radius - 1.0)
        assert error.min() > -1e-12  # the faces lie inside of the sphere
        assert error.max() < edge**2 / 6.0 * 1.1


def test_face_that_looks_the_other_way_is_no_partner() -> None:
    feet = measure([[0.3, 0.4, 0.02]], [[0, 0, -1]], square())
    assert feet.reasons[0] == NotAssessed.NO_FACE
    assert np.isnan(feet.distances[0])


def test_sixty_degrees_are_the_limit() -> None:
    for angle, reason in ((59.9, NotAssessed.ASSESSED), (60.1, NotAssessed.NO_FACE)):
        tilt = np.radians(angle)
        assert measure([[0.3, 0.4, 0.02]], [[np.sin(tilt), 0, np.cos(tilt)]], square()).reasons[0] == reason


def test_beyond_the_search_limit_is_said_to_be() -> None:
    looks = [[0, 0, 1], [0, 0, 1]]
    feet = measure([[0.3, 0.4, 0.0999], [0.3, 0.4, 0.1001]], looks, square(), limit=0.1)
    np.testing.assert_array_equal(feet.reasons, [NotAssessed.ASSESSED, NotAssessed.BEYOND_SEARCH])


def test_foot_on_the_rim_is_a_free_edge() -> None:
    feet = measure([[1.01, 0.4, 0.02], [-0.01, -0.01, 0.0], [0.97, 0.4, 0.02]], np.tile([0, 0, 1.0], (3, 1)), square(3))
    np.testing.assert_array_equal(feet.reasons, [NotAssessed.FREE_EDGE, NotAssessed.FREE_EDGE, NotAssessed.ASSESSED])


def test_foot_nearer_to_the_rim_than_to_the_vertex_is_a_free_edge() -> None:
    feet = measure([[0.97, 0.4, 0.05], [0.9, 0.4, 0.05]], np.tile([0, 0, 1.0], (2, 1)), square(21))
    np.testing.assert_array_equal(feet.reasons, [NotAssessed.FREE_EDGE, NotAssessed.ASSESSED])
    np.testing.assert_allclose(feet.to_rim, [0.03, 0.1], atol=0.006)


def test_sheet_that_looks_away_hides_what_lies_behind() -> None:
    lower, back = square(3), square(3, height=0.05)
    both = Surface(
        np.vstack([lower.vertices, back.vertices]), np.vstack([lower.faces, back.faces[:, ::-1] + len(lower.vertices)])
    )
    feet = measure([[0.3, 0.4, 0.1], [0.3, 0.4, 0.04]], [[0, 0, 1], [0, 0, 1]], both)
    np.testing.assert_array_equal(feet.reasons, [NotAssessed.SHEET_BETWEEN, NotAssessed.ASSESSED])


def test_step_is_measured_to_its_treads_not_to_its_riser() -> None:
    profile = np.array([[-1.0, 0.2], [0.0, 0.2], [0.0, 0.0], [1.0, 0.0]])  # down a step of 0.2 at x = 0
    vertices = np.vstack([np.column_stack([profile[:, 0], np.full(4, y), profile[:, 1]]) for y in (0.0, 1.0)])
    faces = np.vstack([[[k, k + 1, k + 5], [k, k + 5, k + 4]] for k in range(3)])
    step = Surface(vertices, faces)
    points = [[-0.02, 0.5, 0.23], [0.02, 0.5, 0.03], [0.02, 0.5, 0.1]]
    feet = measure(points, [[0, 0, 1], [0, 0, 1], [1, 0, 0]], step)
    np.testing.assert_allclose(feet.distances, [0.03, 0.03, 0.02], rtol=1e-12)


def test_invented_faces_say_nothing() -> None:
    other = dataclasses.replace(square(2), face_invented=[True, False])
    reasons = [measure([p], [[0, 0, 1]], other).reasons[0] for p in ([0.7, 0.2, 0.01], [0.2, 0.7, 0.01])]
    assert reasons == [NotAssessed.NOT_SEEN, NotAssessed.ASSESSED]


def test_triangles_without_area_are_passed_over() -> None:
    plain = square(3)
    bad = dataclasses.replace(plain, faces=np.vstack([[[0, 0, 1], [4, 4, 4]], plain.faces]))
    feet = measure([[0.3, 0.4, 0.02]], [[0, 0, 1]], bad)
    assert feet.distances[0] == pytest.approx(0.02, rel=1e-14)


def test_a_surface_without_faces_is_refused() -> None:
    with pytest.raises(ComparisonError, match="0 faces"):
        normal_distances(square(), Surface(np.zeros((3, 3)), np.zeros((0, 3))), 0.1)


@pytest.mark.parametrize(("limit", "angle"), [(-1.0, 1.0), (0.0, 1.0), (float("nan"), 1.0), (0.1, 2.0)])
def test_a_limit_that_is_no_length_or_angle_is_refused(limit: float, angle: float) -> None:
    with pytest.raises(ParameterError, match="a length above 0 and an angle between 0 and pi / 2"):
        normal_distances(square(), square(), limit, angle)


def rough_ball(rng: np.random.Generator, subdivisions: int = 3) -> Surface:
    """Return a ball with relief and noise, a cap cut off: faces, ridges, hollows and a rim."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    v = mesh.vertices * (1.0 + 0.1 * np.sin(5 * mesh.vertices[:, [0]]) + rng.normal(0, 0.02, (len(mesh.vertices), 1)))
    return Surface(v, mesh.faces[(v[mesh.faces][:, :, 2] < 0.8).all(axis=1)])


def slow_twin(points: Floats, looks: Floats, other: Surface, limit: float) -> tuple[Floats, Floats, Floats]:
    """Return distance, reason (no sheets, no ends) and way to the rim of each point, from every part in turn."""
    tri = other.vertices[other.faces]
    normals = np.cross(tri[:, 1] - tri[:, 0], tri[:, 2] - tri[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    pseudo = angle_weighted_normals(make_mesh(other.vertices, other.faces))
    sides = np.vstack([other.faces[:, [0, 1]], other.faces[:, [1, 2]], other.faces[:, [2, 0]]])
    _, which, count = np.unique(np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True)
    border = set(sides[which[count == 1]].ravel())
    rim = [(other.vertices[a], other.vertices[b]) for a, b in sides[which[count == 1]]]
    distances, reasons = np.full(len(points), np.nan), np.full(len(points), int(NotAssessed.NO_FACE))
    to_rim = np.full(len(points), np.nan)
    for i, (p, look) in enumerate(zip(points, looks, strict=True)):
        nearest = [closest_by_parts(p, t) for t in tri]
        best = limit
        for f in np.flatnonzero(normals @ look >= 0.5):
            q, on = nearest[f]
            size = np.linalg.norm(p - q)
            if size >= best:
                continue
            corners = [other.faces[f, k] for k in on]
            around = np.flatnonzero(np.isin(other.faces, corners).sum(axis=1) == len(corners))
            if any(np.linalg.norm(p - nearest[g][0]) < size * (1 - 1e-9) - 1e-15 for g in around):
                continue
            best = size
            direction = normals[f] if len(on) == 3 else normals[around].sum(0) if len(on) == 2 else pseudo[corners[0]]
            distances[i] = np.copysign(size, (p - q) @ direction)
            to_rim[i] = min(np.linalg.norm(q - closest_on_edge(q, a, b)[0]) for a, b in rim)
            free = (len(on) == 2 and len(around) == 1) or (len(on) == 1 and corners[0] in border)
            reasons[i] = NotAssessed.FREE_EDGE if free else NotAssessed.ASSESSED
    return distances, reasons, to_rim


def closest_on_edge(p: Floats, a: Floats, b: Floats) -> tuple[Floats, float]:
    """Return the nearest point of an edge and how far along it lies, 0 to 1."""
    t = float(np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0))
    return a + t * (b - a), t


def closest_by_parts(p: Floats, tri: Floats) -> tuple[Floats, list[int]]:
    """Return the nearest point of a triangle and the corners of the part it lies on: all three, two or one."""
    normal = np.cross(tri[1] - tri[0], tri[2] - tri[0])
    foot = p - (p - tri[0]) @ normal / (normal @ normal) * normal
    weights = np.linalg.solve(np.column_stack([tri[1] - tri[0], tri[2] - tri[0], normal]), foot - tri[0])[:2]
    if (weights > 0).all() and weights.sum() < 1:
        return foot, [0, 1, 2]
    parts = []
    for k in range(3):
        on_edge, t = closest_on_edge(p, tri[k], tri[(k + 1) % 3])
        parts.append((on_edge, [k] if t == 0 else [(k + 1) % 3] if t == 1 else [k, (k + 1) % 3]))
    return min(parts, key=lambda part: float(np.linalg.norm(p - part[0])))


@pytest.mark.parametrize("far", [0.0, 1e6])
def test_kernel_agrees_with_its_slow_twin(rng: np.random.Generator, far: float) -> None:
    other = rough_ball(rng, 2)
    points = rng.normal(size=(80, 3))
    points *= (rng.uniform(0.8, 1.2, 80) / np.linalg.norm(points, axis=1))[:, None]
    looks = points / np.linalg.norm(points, axis=1)[:, None] + rng.normal(0, 0.3, points.shape)
    looks /= np.linalg.norm(looks, axis=1)[:, None]
    distances, reasons, to_rim = slow_twin(points, looks, other, LIMIT)
    moved = dataclasses.replace(other, vertices=other.vertices + far)
    feet = measure(points + far, looks, moved)
    assert len(set(reasons)) == 3
    near = ~(to_rim > LIMIT)  # NaN where there is no foot; beyond, it may be said to be infinitely far
    np.testing.assert_allclose(feet.to_rim[near], to_rim[near], atol=0.1)  # a quarter of an edge
    assert (feet.to_rim[~near] > LIMIT - 0.1).all()
    reasons[(reasons == NotAssessed.ASSESSED) & (feet.to_rim < np.abs(distances))] = NotAssessed.FREE_EDGE
    seen = feet.reasons != NotAssessed.SHEET_BETWEEN
    assert seen.mean() > 0.9
    np.testing.assert_array_equal(feet.reasons[seen], reasons[seen])
    np.testing.assert_allclose(feet.distances, distances, atol=1e-12 if far == 0 else 5e-10)  # 1e6 m holds 1.2e-10 m


def test_rigid_motion_and_order_of_vertices_and_faces_change_nothing(rng: np.random.Generator) -> None:
    other, surface = rough_ball(rng), rough_ball(rng, 4)
    plain = normal_distances(surface, other, LIMIT)
    R, t = rotation_from_vector(np.array([0.3, -0.5, 1.1])), np.array([3.0, -7.0, 0.5])
    order, faces = rng.permutation(len(surface.vertices)), rng.permutation(len(other.faces))
    back = np.argsort(order)
    moved = Surface(surface.vertices[order] @ R.T + t, back[surface.faces])
    again = normal_distances(moved, Surface(other.vertices @ R.T + t, np.roll(other.faces[faces], 1, axis=1)), LIMIT)
    np.testing.assert_allclose(again.distances[back], plain.distances, atol=1e-12)
    np.testing.assert_array_equal(again.reasons[back], plain.reasons)


def test_any_number_of_threads_gives_the_same_bits(rng: np.random.Generator) -> None:
    import numba

    other, surface = rough_ball(rng), rough_ball(rng, 4)
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        one = normal_distances(surface, other, LIMIT)
    finally:
        numba.set_num_threads(threads)
    many = normal_distances(surface, other, LIMIT)
    np.testing.assert_array_equal(one.distances, many.distances)
    np.testing.assert_array_equal(one.faces, many.faces)


def test_where_a_search_begins_changes_nothing(rng: np.random.Generator) -> None:
    other = rough_ball(rng)
    tree = build_tree(other, np.zeros(3), np.pi / 3)
    points = rng.normal(size=(40, 3))
    points *= (rng.uniform(0.8, 1.2, 40) / np.linalg.norm(points, axis=1))[:, None]
    stack, bounds = np.empty(DEPTH, dtype=np.int64), np.empty(DEPTH)
    for p in points:
        looks = tuple(p / np.linalg.norm(p))
        for kind in (ANY, LOOKING, STANDING):
            found = {
                nearest_point(tree, tuple(p), looks, (LIMIT, 0.5), seed, kind, stack, bounds)[:5]
                for seed in (-1, 0, 77, len(tree.faces) - 1)
            }
            assert len(found) == 1


def test_points_that_no_face_of_a_node_can_stand_under_are_passed_by_without_loss(rng: np.random.Generator) -> None:
    other = rough_ball(rng)
    tree = build_tree(other, np.zeros(3), np.pi / 3)
    nodes = tree.nodes.copy()
    nodes[:, 10] = np.pi  # nothing is passed by
    stack, bounds = np.empty(DEPTH, dtype=np.int64), np.empty(DEPTH)
    for p in rng.normal(0.0, 0.6, (200, 3)):
        looks = tuple(p / np.linalg.norm(p))
        both = [
            nearest_point(t, tuple(p), looks, (LIMIT, 0.5), -1, STANDING, stack, bounds)[:5]
            for t in (tree, tree._replace(nodes=nodes))
        ]
        assert both[0] == both[1]


def test_points_that_lie_side_by_side_find_what_each_finds_alone(rng: np.random.Generator) -> None:
    other = rough_ball(rng)
    d = rng.normal(size=(1500, 3))
    d /= np.linalg.norm(d, axis=1)[:, None]
    height = np.where(
        d[:, 2] > 0.3, 0.002 * rng.normal(size=1500), 0.3 * d[:, 2]
    )  # beside the surface, and far from it
    points, tree = d * (1.0 + height)[:, None], build_tree(other, np.zeros(3), np.pi / 3)
    together = find_feet(tree, points, d, point_order(points), (0.25, 0.5))
    alone = [find_feet(tree, points[i : i + 1], d[i : i + 1], np.zeros(1, np.int32), (0.25, 0.5)) for i in range(1500)]
    for figure, figures in zip(together, zip(*alone, strict=True), strict=True):
        np.testing.assert_array_equal(figure, np.concatenate(figures))
    assert (together[3] == FOOT).sum() > 500
    assert (together[0] < 0).any()


def test_faces_gathered_for_points_are_those_whose_boxes_meet_theirs(rng: np.random.Generator) -> None:
    tree = build_tree(rough_ball(rng), np.array([0.1, 0.2, 0.3]), np.pi / 3)
    corners = tree.vertices[tree.faces] - tree.shift
    low, high = corners.min(axis=1), corners.max(axis=1)
    numbers, boxes = np.empty(packets.MOST_FACES, dtype=np.int64), np.empty((6, packets.MOST_FACES))
    near, meets, chosen = np.empty_like(boxes), np.empty(packets.MOST_FACES + 8, np.uint8), np.empty_like(numbers)
    stack = np.empty(DEPTH, dtype=np.int64)
    for middle in rng.normal(0.0, 0.6, (40, 3)):
        box = middle - 0.3, middle + 0.3
        meet = np.flatnonzero((low <= box[1]).all(axis=1) & (high >= box[0]).all(axis=1))
        n = packets.gather_faces(tree, tuple(box[0]), tuple(box[1]), numbers, boxes, stack)
        assert sorted(numbers[:n]) == meet.tolist()
        np.testing.assert_array_equal(boxes[:, :n].T, np.hstack([low, high])[numbers[:n]])
        smaller = middle - 0.1, middle + 0.2
        few = packets.pick_faces(boxes, n, tuple(smaller[0]), tuple(smaller[1]), meets, chosen, near)
        meet = np.flatnonzero((low <= smaller[1]).all(axis=1) & (high >= smaller[0]).all(axis=1))
        assert sorted(numbers[chosen[:few]]) == meet.tolist()
        np.testing.assert_array_equal(near[:, :few], boxes[:, chosen[:few]])
    assert packets.gather_faces(tree, (-2.0,) * 3, (2.0,) * 3, numbers[:64], boxes, stack) == -1  # no room for all


@pytest.mark.parametrize("off", [0.0, 1e-12, 1e-7, 1e-3])
def test_places_on_a_surface_are_on_it_and_on_the_first_of_the_faces_that_hold_them(
    rng: np.random.Generator, off: float
) -> None:
    """Corners, middles of edges and places on faces: what is told from a face's plane drops none that holds them."""
    other = rough_ball(rng)
    tree = build_tree(other, np.zeros(3), np.pi / 3)
    weights = np.vstack([np.eye(3), 0.5 - 0.5 * np.eye(3), [[0.2, 0.3, 0.5]]])
    corners = other.vertices[other.faces]
    points = np.einsum("wk,fkc->wfc", weights, corners).reshape(-1, 3)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.tile(normals / np.linalg.norm(normals, axis=1)[:, None], (len(weights), 1))
    points += off * normals
    found = find_feet(tree, points, normals, point_order(points), (0.25, 0.5))
    has_foot = found[0] >= 0  # in a hollow rounding alone may leave a place over no face of an edge
    assert has_foot.mean() > 0.9
    assert (np.abs(found[2][has_foot]) <= off * (1.0 + 1e-9) + 5e-16).all()
    stack, bounds = np.empty(DEPTH, dtype=np.int64), np.empty(DEPTH)
    n_faces = 0
    for i in rng.choice(len(points), 500, replace=False):
        alone = nearest_point(tree, tuple(points[i]), tuple(normals[i]), (0.25, 0.5), -1, LOOKING, stack, bounds)
        if alone[4] == FACE:
            n_faces += 1
            assert np.sqrt(alone[0]) == abs(found[2][i])
            assert tree.order[alone[1]] == found[0][i]
    assert n_faces > 50
