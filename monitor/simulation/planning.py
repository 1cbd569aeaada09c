"""A campaign on paper: from where, at which resolution, is a change of 2 mm seen?

A scene, an instrument and stations go in; for every point of the surface come out how many stations see it, how
dense, how sharp, how sure, and the smallest change that two such campaigns tell from none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from monitor.simulation.instruments import Instrument
from monitor.simulation.scanner import REFERENCE_RANGE, REFERENCE_REFLECTANCE, Target, cast, range_noise
from monitor.simulation.scenes import Body, Scene
from projects.errors import ParameterError
from projects.model import Z95, Bools, Floats
from projects.transforms import apply, invert
from projects.triangles import area_vectors

FEWEST_PULSES = 3.0  # over the extent asked for: from so many on their mean says where the surface is
CLEAR = 5e-4  # m and 1e-4 of the range: what is met nearer than this before a point hides it


@dataclass(frozen=True)
class Visibility:
    """What a set of stations sees of points (n,) of a surface; NaN where none sees them.

    Attributes
    ----------
    n_stations : (n,) that see the point: in sight, with at least three pulses over the extent asked for.
    spacing : (n,) m, between neighbouring pulses on the surface, of the densest station (root of the area a pulse).
    footprint : (n,) m, 1/e2 diameter of the beam on the surface, of the sharpest station (root of its two axes).
    sigma : (n,) m, expected one sigma of the surface's place along its normal, over the extent asked for, one epoch.
    smallest_change : (n,) m, that differs from zero at 95 % confidence between two epochs scanned alike.
    in_sight : (n,) whether a station has the point in sight, be it with fewer pulses than three.
    """

    n_stations: Floats
    spacing: Floats
    footprint: Floats
    sigma: Floats
    smallest_change: Floats
    in_sight: Bools


@dataclass(frozen=True)
class _View:
    """What each station sees of each point, (m, n): NaN where it does not.

    `spacing` [m] between pulses, `footprint` [m] the width of the beam and `sigma` [m] of the mean, over the surface,
    the share of a change that the beam leaves of it, `kept`, and whether it has the point `in_sight`, with however few
    pulses.
    """

    spacing: Floats
    footprint: Floats
    sigma: Floats
    kept: Floats
    in_sight: Bools


def spread_points(body: Body, n: int, *, seed: int = 0) -> tuple[Floats, Floats]:
    """Return points and normals (n, 3) spread evenly at random over a body's triangles."""
    corners = body.vertices[body.faces]
    across = area_vectors(corners)
    area = np.linalg.norm(across, axis=1)
    rng = np.random.default_rng(seed)
    face = rng.choice(len(area), n, p=area / area.sum())
    a, b = np.sqrt(rng.uniform(size=n)), rng.uniform(size=n)
    weights = np.stack([1.0 - a, a * (1.0 - b), a * b], axis=1)
    return np.einsum("ni,nij->nj", weights, corners[face]), across[face] / area[face, None]


def visible_change(
    scene: Scene, instrument: Instrument, stations: Sequence[Floats], points: Floats, normals: Floats, *,
    step: float | None = None, extent: float = 0.02, reflectance: float = 0.6, sigma_registration: float = 0.0,
) -> Visibility:  # fmt: skip
    """Return what stations see of points of a scene, and the smallest change that shows there between two epochs.

    Parameters
    ----------
    stations : poses T_project_scanner (4, 4).
    points, normals : (n, 3) of the surface, see `spread_points`.
    step : rad, angular step; None: the instrument's finest.
    extent : m, diameter of the patch that is averaged, and of the change that is to be seen.
    reflectance : of the surface, 0 to 1.
    sigma_registration : m, one sigma of each station's place, the same in both epochs.

    Notes
    -----
    Range r, incidence a, step d, noise sigma_r of `range_noise`, sigma_a of the angles. A pulse stands for the area
    (r d)**2 / cos a, so N = pi / 4 extent**2 cos a / (r d)**2 pulses share a patch, and a station gives its place with

        sigma_s**2 = ((sigma_r cos a)**2 + (sigma_a r sin a)**2) / N + sigma_registration**2.

    Stations add up as 1 / sigma**2 = sum 1 / sigma_s**2. The smallest change is 1.96 sqrt(2) sigma / k, the level of
    detection of Lague et al. 2013 (eq. 1, with the registration in quadrature) of two epochs alike; k is the share of
    a beam's power within the extent, 1 - exp(-extent**2 / (8 s**2)) with s a quarter of the footprint: what is
    smaller than the beam shows flattened. A station with fewer than three pulses on the patch does not see it, though
    it may have it in sight. Cyclic and axis errors repeat between epochs scanned alike and are left out.
    """
    view = _look(scene, instrument, stations, points, normals, step, extent, reflectance, sigma_registration)
    return _sum_up(view, np.ones(len(stations), dtype=bool))


def plan_campaign(
    scene: Scene, instrument: Instrument, candidates: Sequence[Floats], points: Floats, normals: Floats, *,
    change: float = 0.002, share: float = 0.95, step: float | None = None, extent: float = 0.02,
    reflectance: float = 0.6, sigma_registration: float = 0.0,
) -> tuple[list[int], Visibility]:  # fmt: skip
    """Return which of the candidate stations to take, in the order of their worth, and what they see together.

    At each turn the station is taken that shows a change of `change` [m] at the most points where it did not show
    yet, until `share` of what all candidates together would show is reached. Parameters as in `visible_change`.
    """
    view = _look(scene, instrument, candidates, points, normals, step, extent, reflectance, sigma_registration)
    everything = _sum_up(view, np.ones(len(candidates), dtype=bool))
    wanted = share * (everything.smallest_change <= change).sum()
    taken: list[int] = []
    while (_sum_up(view, _only(taken, len(candidates))).smallest_change <= change).sum() < wanted:
        shown = [
            -1 if k in taken else int(
                (_sum_up(view, _only([*taken, k], len(candidates))).smallest_change <= change).sum()
            )
            for k in range(len(candidates))
        ]  # fmt: skip
        taken.append(int(np.argmax(shown)))
    return taken, _sum_up(view, _only(taken, len(candidates)))


def _only(taken: Sequence[int], n: int) -> Bools:
    """Return the mask (n,) of the stations taken."""
    return np.isin(np.arange(n), taken)


def _look(
    scene: Scene, instrument: Instrument, stations: Sequence[Floats], points: Floats, normals: Floats,
    step: float | None, extent: float, reflectance: float, sigma_registration: float,
) -> _View:  # fmt: skip
    """Return what each station would see of each point; refuse where there is no station or no extent."""
    if not len(stations) or extent <= 0.0 or not 0.0 < reflectance <= 1.0:
        raise ParameterError(
            f"{len(stations)} stations, extent {extent} m, reflectance {reflectance}: at least one station, an extent "
            "above 0 and a reflectance of up to 1 are needed"
        )
    step, target = instrument.angular_step if step is None else step, Target.of(scene, 2)
    views, sights = [], []
    for pose in stations:
        towards = points - pose[:3, 3]
        r = np.linalg.norm(towards, axis=1)
        cosine = -(towards * normals).sum(axis=1) / r
        rays = np.concatenate([np.broadcast_to(pose[:3, 3], points.shape), towards / r[:, None]], axis=1)
        met = cast(target, rays.astype(np.float32)[:, None], 2).t[:, 0]
        local = apply(invert(pose), points)
        elevation = np.arcsin(np.clip(local[:, 2] / r, -1.0, 1.0))
        facing = np.clip(cosine, 1e-6, 1.0)
        power = reflectance / REFERENCE_REFLECTANCE * facing * (REFERENCE_RANGE / r) ** 2
        n_pulses = 0.25 * np.pi * extent**2 * facing / (r * step) ** 2
        in_sight = (cosine > 0.0) & (met > r - CLEAR - 1e-4 * r) & (power >= instrument.power_min)
        in_sight &= (r >= instrument.range_min) & (r <= instrument.range_max)
        in_sight &= (elevation >= instrument.elevation_min) & (elevation <= instrument.elevation_max)
        along = range_noise(instrument, power) * facing
        aside = instrument.angular_noise * r * np.sqrt(1.0 - facing**2)
        sigma = np.sqrt((along**2 + aside**2) / n_pulses + sigma_registration**2)
        beam = np.hypot(instrument.beam_diameter, instrument.beam_divergence * r) / np.sqrt(facing)
        kept = 1.0 - np.exp(-2.0 * (extent / np.maximum(beam, 1e-12)) ** 2)
        sees = in_sight & (n_pulses >= FEWEST_PULSES)
        sights.append(in_sight)
        views.append(np.where(sees, np.stack([r * step / np.sqrt(facing), beam, sigma, kept]), np.nan))
    spacing, footprint, sigmas, kepts = np.stack(views, axis=1)
    return _View(spacing, footprint, sigmas, kepts, np.stack(sights))


def _sum_up(view: _View, taken: Bools) -> Visibility:
    """Return what the stations `taken` (m,) see together."""
    sees = np.isfinite(view.sigma) & taken[:, None]
    seen = sees.any(axis=0)

    def best(values: Floats) -> Floats:
        """Return the least value (n,) of the stations that see a point, NaN where none does."""
        return np.where(seen, np.where(sees, values, np.inf).min(axis=0), np.nan)

    weight = np.where(sees, 1.0 / np.maximum(view.sigma, 1e-12) ** 2, 0.0)
    total = np.where(seen, weight.sum(axis=0), np.nan)
    sigma = 1.0 / np.sqrt(total)
    kept = np.where(sees, weight * view.kept, 0.0).sum(axis=0) / total
    return Visibility(
        sees.sum(axis=0), best(view.spacing), best(view.footprint), sigma, Z95 * np.sqrt(2.0) * sigma / kept,
        np.asarray(view.in_sight[taken].any(axis=0)),
    )  # fmt: skip
