"""Which scans two epochs have in common: what was measured once cannot show a change.

In come two epochs of an object; out come pairs of names of scans, or of meshes, with the same content, whatever their
files are called. The same points in another order are not found.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from monitor.record import Place
from projects.errors import ComparisonError
from projects.model import Floats
from projects.raw import ScanHeader

ROUNDED = 1e-5  # m, between the same point in two formats; no instrument repeats a whole scan to it


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
        f"monitor remove-epoch {compared.project.path} {compared.object_id} {compared.epoch_id}"
    )


def describe_copies(place: Place) -> list[str]:
    """Return in words which scans of an epoch other epochs of the object hold already."""
    others = [e.epoch_id for e in place.project.epochs(place.object_id) if e.epoch_id != place.epoch_id]
    return [
        f"{name} is {earlier} of epoch {other}"
        for other in others
        for earlier, name in find_shared(Place(place.project, place.object_id, other), place)
    ]


def find_shared(one: Place, other: Place) -> list[tuple[str, str]]:
    """Return the names of the scans (or meshes) that two epochs have in common, as each epoch calls them."""
    records = [p.project.epoch(p.object_id, p.epoch_id) for p in (one, other)]
    if all(r.is_mesh for r in records):
        names = [str(r.sources[0]["file"]) if r.sources else r.epoch_id for r in records]
        return [(names[0], names[1])] if _is_same_mesh(one, other) else []
    headers = [p.project.scan_headers(p.object_id, p.epoch_id) for p in (one, other)]
    return [(a.name, b.name) for a in headers[0] for b in headers[1] if _is_same_scan((one, a), (other, b))]


def _is_same_mesh(one: Place, other: Place) -> bool:
    """Return whether two finished meshes have the same vertices."""
    counts = [p.project.latest(p.object_id, p.epoch_id, "mesh") for p in (one, other)]
    if any(c is None for c in counts) or counts[0].counts != counts[1].counts:  # type: ignore[union-attr]
        return False
    vertices = [p.project.get(p.object_id, p.epoch_id, "mesh").vertices for p in (one, other)]
    return _is_near(vertices[0], vertices[1])


def _is_same_scan(one: tuple[Place, ScanHeader], other: tuple[Place, ScanHeader]) -> bool:
    """Return whether two stored scans have the same points in the same order; read only where all else is alike."""
    a, b = one[1], other[1]
    if a.n_points != b.n_points or not _is_near(a.bounds, b.bounds):
        return False
    if (a.source_sha256, a.source_index) == (b.source_sha256, b.source_index):
        return True
    return all(_is_near(p, q) for p, q in zip(_points(*one), _points(*other), strict=True))


def _points(place: Place, header: ScanHeader) -> Iterator[Floats]:
    """Yield the points of a stored scan, piece by piece."""
    chunks = place.project.iterate_scan(place.object_id, place.epoch_id, header.index)
    return (chunk.cloud.points for chunk in chunks)


def _is_near(one: Floats, other: Floats) -> bool:
    """Return whether coordinates (n, 3) [m] are the same but for how they were written."""
    return bool(np.abs(one - other).max() <= ROUNDED)
