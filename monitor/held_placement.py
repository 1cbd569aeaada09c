"""How sure the scans of two epochs are placed against what their registration holds to.

In: two epochs, their surfaces, and the motion between them with the weights that it rests on. Out: the surfaces, of
whose vertices is stated anew what neighbourhoods share in error. An epoch alone states it about the mean of the whole;
a registration moves with what it gives weight, and a part that stands off has less of it, or none: that part is as sure
as its scans are placed against the others (the front and the landing of a staircase, each held by control points of
its own; the face of a pedestal that one scan stands before).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from monitor.adjusted import adjusted_clouds
from monitor.quality import placement_of
from monitor.reconstruction.mesh import face_areas_and_normals
from monitor.record import Place
from monitor.registration.network.placement import Placement, placement_sigma
from projects.identifiers import scan_product
from projects.model import Floats, Registration, Surface
from projects.transforms import apply

REACH = 3.0  # spacings of the vertices, within which one of the other surface is the same place


def place_against_held(
    places: tuple[Place, Place], surfaces: tuple[Surface, Surface], registration: Registration
) -> tuple[Surface, Surface]:
    """Return the surfaces (reference, compared) with `sigma_shared` as the registration leaves it: about what it holds
    to, by the weight that it gives each vertex.

    As they are where the registration does not say, or holds to nothing; an epoch without scans or without an
    adjustment stays as it is. Beside a layer what it lies on holds the motion too, and counts.
    """
    reference, compared = surfaces
    weights = registration.weights
    if weights is None or len(weights) != len(compared.vertices) or not weights.any():
        return surfaces
    on_reference = _weights_on(reference, compared, weights, registration)
    return _place_anew(places[0], reference, on_reference), _place_anew(places[1], compared, weights)


def _weights_on(reference: Surface, compared: Surface, weights: Floats, registration: Registration) -> Floats:
    """Return the weights (n,) of the reference's vertices: each has those of the compared ones that come next to it."""
    area = float(face_areas_and_normals(reference.vertices, reference.faces)[0].sum())
    reach = REACH * float(np.sqrt(area / len(reference.vertices)))
    moved = apply(registration.T_target_source, compared.vertices)
    nearest = cKDTree(reference.vertices).query(moved, distance_upper_bound=reach, workers=-1)[1]
    summed = np.bincount(nearest, weights, len(reference.vertices) + 1)
    return np.asarray(summed[:-1], dtype=float)  # what has none near it is the last


def _place_anew(place: Place, surface: Surface, weights: Floats) -> Surface:
    """Return the surface with what its neighbourhoods share in error, its scans' places told about what has weight."""
    placement = None if surface.sigma_shared is None else _placement(place)
    if placement is None or not weights.any():
        return surface
    assert surface.sigma_shared is not None
    about_all, about_held = (placement_sigma(surface.vertices, placement, by) for by in (None, weights))
    rest2 = np.maximum(surface.sigma_shared**2 - about_all**2, 0.0)
    return replace(surface, sigma_shared=np.sqrt(rest2 + about_held**2))


def _placement(place: Place) -> Placement | None:
    """Return where the adjustment of an epoch put its scans; None where there is none, or what it adjusted is lost."""
    network = place.project.latest(place.object_id, place.epoch_id, "network")
    if network is None:
        return None
    found = place.get(network)
    scans = [place.project.latest(place.object_id, place.epoch_id, scan_product(k))
             for k in range(len(found["T_project_given"]))]  # fmt: skip
    kept = [step for step in scans if step is not None]
    return placement_of(adjusted_clouds(place, kept, network), found) if len(kept) == len(scans) else None
