"""A surface made ready to be measured against: what is asked of all of it at once, and its tree where that is small.

A tree holds some 140 octets a vertex, more than the surface and its change together. Of a large surface it is made
piece by piece where it is asked (`portions`); what is left here grows with the surface and is kept with its side.
"""

from __future__ import annotations

from dataclasses import dataclass

from monitor.comparison.distances.discord import sigma_of_discord
from monitor.comparison.distances.mesh_tree import MeshTree, grow_tree, require_faces
from monitor.comparison.distances.rim import Rim, ends_of
from monitor.comparison.distances.scratch import keep_on_disk
from monitor.comparison.distances.stars import Neighbours, gather_neighbours, make_mesh, survey_vertices
from monitor.morton import Cells, cells_of, face_order
from projects.model import Bools, Floats, Surface

FACES_PER_TREE = 4_000_000  # some 0.3 GiB


@dataclass(frozen=True)
class Shell:
    """A surface, and of its n vertices `normals` (n, 3), angle-weighted, `areas` [m2], `is_border`, `neighbours` and
    `discord` [m]; its `rim`, None where it is closed; areas and rim are of what was measured (`ends_of`).

    `shift` (3,) [m] is what its tree's coordinates are less, `cells` those that its faces are ordered by, `limits` the
    search limit [m] and the largest angle [rad] between normals. `tree` is None where the surface has more than
    `faces_per_tree` faces.
    """

    surface: Surface
    shift: Floats
    limits: tuple[float, float]
    cells: Cells
    normals: Floats
    areas: Floats
    is_border: Bools
    neighbours: Neighbours
    discord: Floats
    rim: Rim | None
    tree: MeshTree | None
    faces_per_tree: int


def make_shell(
    surface: Surface, shift: Floats, limits: tuple[float, float], faces_per_tree: int = FACES_PER_TREE
) -> Shell:
    """Return a surface made ready; raise `ComparisonError` where it has no face with an area.

    `shift` (3,) [m]; `limits` are the search limit [m] and the largest angle [rad] between normals.
    """
    vertices, faces = require_faces(surface)
    cells = cells_of(vertices, shift)
    order = face_order(vertices, faces, shift, cells)
    mesh = make_mesh(vertices, faces[order], shift)
    survey, tree = survey_vertices(mesh), None
    if len(faces) <= faces_per_tree:
        tree = grow_tree(mesh, order, survey, limits[1])
    else:
        del order
        survey = survey._replace(normals=keep_on_disk(survey.normals), areas=keep_on_disk(survey.areas))
    starts, near = gather_neighbours(mesh, survey.n_neighbours)
    neighbours = Neighbours(keep_on_disk(starts), keep_on_disk(near))
    discord = keep_on_disk(sigma_of_discord(surface, neighbours))
    ends = ends_of(surface, mesh, survey, limits[0])
    return Shell(surface, shift, limits, cells, survey.normals, ends.areas, ends.is_border, neighbours, discord,
                 ends.rim, tree, faces_per_tree)  # fmt: skip
