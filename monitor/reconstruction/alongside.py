"""Whether the span of a hole lies along a measured sheet, nearer than the cells of the mesh can tell apart.

A hole with a piece of the surface in its midst has two rims: a span of the outer one lies just under that piece or
above it, and is no part of the body. So does the span of the border of a flat sheet, which is its own back.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from monitor.reconstruction.mesh import compact, normals_by_angle
from projects.model import Floats, Ints

OFF_RIM = 2.0  # longest edges from the rim, within which the span and what is beyond the rim meet
FLATTEST = 0.1  # height over distance from the rim, below which a span follows a sheet: 6 degrees
HANDFUL = 12  # vertices of a span: fewer only come near in passing


def lies_along(places: Floats, n_rim: int, vertices: Floats, faces: Ints, longest: float) -> bool:
    """Return whether a span, `places` (k, 3) m with its rim first, follows a sheet of measured faces (m, 3).

    It does where more than a handful of its vertices, which lie up to `longest` (m) apart, lie nearer to a sheet than
    that, and than a tenth of the way to the rim.
    """
    inner = places[n_rim:]
    if not len(inner):
        return False
    to_rim = cKDTree(places[:n_rim]).query(inner)[0]
    is_off = to_rim > OFF_RIM * longest
    if np.count_nonzero(is_off) <= HANDFUL:
        return False
    inner, to_rim = inner[is_off], to_rim[is_off]
    used, faces = compact(len(vertices), faces)
    sheet = vertices[used]
    distance, nearest = cKDTree(sheet).query(inner, distance_upper_bound=longest)
    is_near = np.isfinite(distance)
    if np.count_nonzero(is_near) <= HANDFUL:
        return False
    nearest = nearest[is_near]
    ways = normals_by_angle(sheet, faces)[nearest]
    height = np.abs(np.einsum("ij,ij->i", inner[is_near] - sheet[nearest], ways))
    return int(np.count_nonzero(height < FLATTEST * to_rim[is_near])) > HANDFUL
