"""What the stations of an epoch saw, which tells removed from not seen.

In: an epoch as the store keeps it; out: the sight of each station in the epoch's coordinates, from all points of its
raw scan, and of a grid where its beams met nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from monitor.comparison.sight.beam_grid import GridBuilder
from monitor.comparison.sight.stations import StationSight, gather_sight
from monitor.record import Place
from projects.model import Floats
from projects.raw import ScanHeader
from projects.transforms import apply


def gather_sights(place: Place) -> list[StationSight]:
    """Return what each station of an epoch saw, in the epoch's coordinates; none where nobody says where it stood."""
    network = place.project.latest(place.object_id, place.epoch_id, "network")
    if network is None:
        return []
    motions = place.get(network)["T_project_given"]
    found = []
    headers = place.project.scan_headers(place.object_id, place.epoch_id)
    for header, motion in zip(
        headers[: len(motions)], motions, strict=True
    ):  # repeated scans have one motion and sight
        pose = motion @ header.pose
        if np.isfinite(header.origin).all():
            found.append(_gather_sight(place, header, pose))
    return [sight for sight in found if sight is not None]


def _gather_sight(place: Place, header: ScanHeader, pose: Floats) -> StationSight | None:
    """Return what a station saw whose scan stands at `pose` (4, 4) in the epoch's coordinates, and, of a grid, where
    its beams met nothing."""
    builder = GridBuilder(header.n_points + sum(header.dropped.values()))
    sight = gather_sight(apply(pose, header.origin[None])[0], _points(place, header, pose, builder))
    return None if sight is None else replace(sight, grid=builder.finish(pose[:3, :3]))


def _points(place: Place, header: ScanHeader, pose: Floats, builder: GridBuilder) -> Iterator[Floats]:
    """Yield the points of a raw scan, all of them, in the epoch's coordinates, and count them as what its grid met."""
    for chunk in place.project.iterate_scan(place.object_id, place.epoch_id, header.index):
        if header.is_grid and chunk.rows is not None and chunk.columns is not None:
            builder.add(chunk.rows, chunk.columns, chunk.cloud.points - header.origin)
        yield apply(pose, chunk.cloud.points)
