"""How sure the scans of two epochs are placed against what their registration holds to.

In: two epochs, their surfaces, and the motion between them with what it held stable. Out: the surfaces, of whose
vertices is stated anew what neighbourhoods share in error. An epoch alone states it about the mean of the whole; a
registration that leaves a part out, as one that stands off, moves with the rest, and that part is as sure as its scans
are placed against the others (the front and the landing of a staircase, each held by control points of its own).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from monitor.adjusted import adjusted_clouds
from monitor.comparison.stars import make_mesh, vertex_areas
from monitor.quality import placement_of
from monitor.record import Place
from monitor.registration.placement import Placement, placement_sigma
from projects.model import Bools, Registration, Surface
from projects.transforms import apply

REACH = 3.0  # spacings of the vertices, within which one of the other surface is the same place


def place_against_held(
    places: tuple[Place, Place], surfaces: tuple[Surface, Surface], registration: Registration
) -> tuple[Surface, Surface]:
    """Return the surfaces (reference, compared) with `sigma_shared` as the registration leaves it: of what it held to
    by how these scans fit, of the rest by how sure its scans are placed against them.

    As they are where the registration holds to all of the compared surface, or does not say; an epoch without scans
    or without an adjustment stays as it is.
    """
    reference, compared = surfaces
    held = registration.is_stable
    if held is None or len(held) != len(compared.vertices) or held.all() or not held.any():
        return surfaces
    on_reference = _held_on(reference, compared, held, registration)
    return _place_anew(places[0], reference, on_reference), _place_anew(places[1], compared, held)


def _held_on(reference: Surface, compared: Surface, held: Bools, registration: Registration) -> Bools:
    """Return which vertices (n,) of the reference lie where the registration holds to the compared surface."""
    area = vertex_areas(make_mesh(reference.vertices, reference.faces))
    moved = apply(registration.T_target_source, compared.vertices)
    reach = REACH * float(np.sqrt(np.median(area)))
    nearest = cKDTree(moved).query(reference.vertices, distance_upper_bound=reach, workers=-1)[1]
    return np.append(held, False)[nearest]  # none within reach is the last


def _place_anew(place: Place, surface: Surface, held: Bools) -> Surface:
    """Return the surface with what its neighbourhoods share in error, where its scans were put told against `held`."""
    placement = None if surface.sigma_shared is None else _placement(place)
    if placement is None or not held.any():
        return surface
    assert surface.sigma_shared is not None
    about_all, about_held = (placement_sigma(surface.vertices, placement, which) for which in (None, held))
    rest2 = np.maximum(surface.sigma_shared**2 - about_all**2, 0.0)
    return replace(surface, sigma_shared=np.sqrt(rest2 + about_held**2))


def _placement(place: Place) -> Placement | None:
    """Return where the adjustment of an epoch put its scans; None where there is none, or what it adjusted is lost."""
    network = place.project.latest(place.object_id, place.epoch_id, "network")
    if network is None:
        return None
    found = place.get(network)
    scans = [place.project.latest(place.object_id, place.epoch_id, f"scan{k:03d}")
             for k in range(len(found["T_project_given"]))]  # fmt: skip
    kept = [step for step in scans if step is not None]
    return placement_of(adjusted_clouds(place, kept, network), found) if len(kept) == len(scans) else None
