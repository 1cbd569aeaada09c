"""Which scans two epochs have in common: what was measured once cannot show a change.

In come two epochs of an object; out come pairs of names of scans, or of meshes, with the same content, whatever their
files are called and in whatever order they hold it. A finished mesh that was edited is the one that it was made of:
where its vertices stayed, nothing was measured.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from monitor.record import Place
from projects.errors import ComparisonError
from projects.model import Floats, Ints, Surface
from projects.raw import ScanHeader

ROUNDED = 1e-5  # m, between the same point in two formats; no instrument repeats a whole scan to it
N_PLACES = 1000  # of a scan or a mesh that are looked for in the other
ALL, MOST = 0.99, 0.5  # of the places: that two scans have in common which are one, that an edited mesh has kept
SPARSE = 0.1  # of the way from a vertex to the next: nearer, another survey has one by chance


def require_own_scans(reference: Place, compared: Place) -> None:
    """Raise `ComparisonError` where two epochs hold the same scan."""
    shared = find_shared(reference, compared)
    if not shared:
        return
    names = ", ".join(one if one == other else f"{one} is {other}" for one, other in shared[:3])
    more = f" and {len(shared) - 3} more" if len(shared) > 3 else ""
    raise ComparisonError(
        f"epochs {reference.epoch_id} and {compared.epoch_id} of object {compared.object_id} hold the same "
        f"measurements ({names}{more}): what was measured once can show no change, and its level of detection is not "
        f"known; take the epoch with the wrong files out and add it again with those of its own survey: "
        f"monitor remove-epoch {compared.project.quoted} {compared.object_id} {compared.epoch_id}"
    )


def describe_copies(place: Place) -> list[str]:
    """Return in words which scans of an epoch other epochs of the object hold already."""
    others = [e.epoch_id for e in place.project.epochs(place.object_id) if e.epoch_id != place.epoch_id]
    return [
        f"{name} is {earlier} of epoch {other}"
        for other in others
        for earlier, name in find_shared(Place(place.project, place.object_id, other), place)
    ]


def describe_doubles(place: Place) -> list[str]:
    """Return in words which scans of an epoch are copies of others of it, in another file or format."""
    headers = place.project.scan_headers(place.object_id, place.epoch_id)
    return [f"{b.name} is {a.name}" for a, b in combinations(headers, 2) if _is_same_scan((place, a), (place, b))]


def find_shared(one: Place, other: Place) -> list[tuple[str, str]]:
    """Return the names of the scans (or meshes) that two epochs have in common, as each epoch calls them."""
    records = [p.project.epoch(p.object_id, p.epoch_id) for p in (one, other)]
    if all(r.is_mesh for r in records):
        names = [str(r.sources[0]["file"]) if r.sources else r.epoch_id for r in records]
        share = _share_of_mesh(one, other)
        return [(names[0], names[1] if share > ALL else f"most of {names[1]}")] if share > MOST else []
    headers = [p.project.scan_headers(p.object_id, p.epoch_id) for p in (one, other)]
    return [(a.name, b.name) for a in headers[0] for b in headers[1] if _is_same_scan((one, a), (other, b))]


def _share_of_mesh(one: Place, other: Place) -> float:
    """Return the share of the vertices of the smaller of two finished meshes that the larger one has too."""
    meshes: list[Surface] = [p.project.get(p.object_id, p.epoch_id, "mesh") for p in (one, other)]
    small, large = sorted(meshes, key=lambda m: len(m.vertices))
    ends = small.vertices[_pick(small.faces)[:, :2]]
    to_next = float(np.median(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)))
    corners = [mesh.vertices[np.unique(mesh.faces)] for mesh in (small, large)]
    found = count_at(_pick(corners[0]), corners[1:], min(ROUNDED, SPARSE * to_next)) > 0
    return float(np.mean(found))


def _is_same_scan(one: tuple[Place, ScanHeader], other: tuple[Place, ScanHeader]) -> bool:
    """Return whether two stored scans have the same points; read only where all else is alike."""
    a, b = one[1], other[1]
    if a.n_points != b.n_points or np.abs(a.bounds - b.bounds).max() > ROUNDED:
        return False
    if (a.source_sha256, a.source_index) == (b.source_sha256, b.source_index):
        return True
    places = _pick(next(_points(*one)))
    counts = [count_at(places, _points(*scan), ROUNDED) for scan in (one, other)]
    return bool(np.mean(counts[0] == counts[1]) > ALL)


def _points(place: Place, header: ScanHeader) -> Iterator[Floats]:
    """Yield the points of a stored scan, piece by piece."""
    chunks = place.project.iterate_scan(place.object_id, place.epoch_id, header.index)
    return (chunk.cloud.points for chunk in chunks)


def _pick(rows: np.ndarray) -> np.ndarray:
    """Return at most `N_PLACES` different ones of the rows (n, 3), at even steps."""
    return np.unique(rows[:: -(-len(rows) // N_PLACES)], axis=0)


def count_at(places: Floats, blocks: Iterable[Floats], within: float) -> Ints:
    """Return how many points lie within so many metres of each place (m, 3), along each axis; `blocks` hold (n, 3)."""
    tree, counts = cKDTree(places), np.zeros(len(places) + 1, dtype=np.int64)
    for points in blocks:
        _, nearest = tree.query(points, p=np.inf, distance_upper_bound=within * (1.0 + 1e-6))
        counts += np.bincount(nearest, minlength=len(counts))
    return counts[:-1]
