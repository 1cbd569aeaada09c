"""Scans that lie beside their object's extent: where they lie, and where it does, in words."""

from __future__ import annotations

import numpy as np

from monitor.boxes import corners_of
from monitor.record import Place
from projects.extent import Extent
from projects.transforms import apply


def lie_beside_extent(place: Place) -> str:
    """Return where the scans of an epoch lie and where the object's extent does, where these are apart as seen from
    above; empty where they are not, or the object has no extent."""
    content = place.project.object(place.object_id).extent
    headers = place.project.scan_headers(place.object_id, place.epoch_id)
    bounds = [apply(h.pose, corners_of(h.bounds)) for h in headers if np.isfinite(h.bounds).all()]
    if content is None or not bounds:
        return ""
    corners = np.vstack(bounds)[:, :2]
    low, high = corners.min(axis=0), corners.max(axis=0)
    extent = Extent.from_mapping(content).corners
    gap = np.maximum(np.maximum(extent.min(axis=0) - high, low - extent.max(axis=0)), 0.0)
    if not gap.any():
        return ""
    middles = (0.5 * (low + high), extent.mean(axis=0))
    lie, asked = (f"x {middle[0]:.1f} m, y {middle[1]:.1f} m" for middle in middles)
    return f"as their poses say, the scans lie about {lie}, the extent about {asked}"
