"""The filtered clouds of an epoch's scans, and their doubtful points, where its adjustment put them, those of a set-up
in one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from monitor.filtered_scans import FilteredScans
from monitor.record import Place
from monitor.setups import join_setups
from projects.model import Floats, PointCloud, Step
from projects.transforms import apply, rotate


def adjusted_clouds(place: Place, scans: Sequence[Step], network: Step) -> list[PointCloud]:
    """Return the filtered clouds of the set-ups, those with points, where the adjustment put them."""
    found = place.get(network)
    motions, setups = found["T_project_given"], found.get("setups", np.arange(len(scans)))
    clouds = [move_cloud(place.get(step), T) for step, T in zip(scans, motions, strict=True)]
    return join_setups(clouds, setups)


def adjusted_doubtful(place: Place, filtered_scans: FilteredScans, network: Step) -> list[PointCloud]:
    """Return the doubtful points of each set-up that has points: one cloud beside each of `adjusted_clouds`."""
    found = place.get(network)
    motions, setups = found["T_project_given"], found.get("setups", np.arange(len(filtered_scans.scans)))
    has_points = np.array([step.counts.get("out", 0) > 0 for step in filtered_scans.scans])
    none = PointCloud(np.empty((0, 3)))
    if not filtered_scans.doubtful:
        return [none] * len(np.unique(setups[has_points]))
    clouds = [move_cloud(place.get(step), T) for step, T in zip(filtered_scans.doubtful, motions, strict=True)]
    joined = []
    for number in np.unique(setups[has_points]):
        own = [cloud for cloud, setup in zip(clouds, setups, strict=True) if setup == number]
        joined += join_setups(own, np.zeros(len(own), dtype=np.int64)) or [none]
    return joined


def move_cloud(cloud: PointCloud, T_target_source: Floats) -> PointCloud:
    """Return a cloud in the target's coordinates, with its normals and the scanners that saw it."""
    return replace(
        cloud,
        points=apply(T_target_source, cloud.points),
        normals=None if cloud.normals is None else rotate(T_target_source, cloud.normals),
        origins=None if cloud.origins is None else apply(T_target_source, cloud.origins),
    )
