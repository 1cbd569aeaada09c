"""Where the scanner stands: stations around an object, how finely each scans, and what its registration states."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from monitor.simulation.scanner import misregister, stand_at
from projects.model import Floats

STOVE_DISTANCE = 4.0  # m; the full resolution of 40000 steps a turn gives 0.63 mm there
ATTIC_DISTANCE = 3.2  # m; a quarter of the full resolution gives 2.0 mm there


@dataclass(frozen=True)
class Station:
    """One set-up of the scanner.

    Attributes
    ----------
    T_project_scanner : (4, 4), where it really stands.
    step : rad, angular step of the scan.
    registered : (4, 4), the pose that the registration states; None: the true one.
    """

    name: str
    T_project_scanner: Floats
    step: float
    registered: Floats | None = None


def stand_around(
    places: Sequence[tuple[float, float, float]], *, spacing: float, surface_radius: float = 0.0
) -> tuple[Station, ...]:
    """Return stations about the origin.

    Parameters
    ----------
    places : of each the angle [degrees, -90 is in front], the distance from the axis and the height [m].
    spacing : m, between neighbouring pulses on a surface `surface_radius` [m] before the axis.
    """
    stations = []
    for k, (angle, distance, height) in enumerate(places, start=1):
        turn = np.radians(angle)
        at = np.array([distance * np.cos(turn), distance * np.sin(turn), height])
        step = spacing / (distance - surface_radius)
        stations.append(Station(f"station {k}", stand_at(at, facing=np.zeros(3)), step))
    return tuple(stations)


def register_with_errors(
    stations: Sequence[Station], *, seed: int, sigma_position: float = 0.0002, sigma_angle: float = 3e-5
) -> tuple[Station, ...]:
    """Return the stations with poses as a registration with these one-sigma errors [m, rad] would state them."""
    rng = np.random.default_rng([seed, 2])
    return tuple(
        dataclasses.replace(
            s, registered=misregister(s.T_project_scanner, rng, sigma_position=sigma_position, sigma_angle=sigma_angle)
        )
        for s in stations
    )


def stove_stations(*, spacing: float = 0.0007) -> tuple[Station, ...]:
    """Return the three stations of an epoch of the Rocaille stove: left, centre and right at equal height.

    Paper 002: three scans an epoch, 0.7 mm mean spacing at the object, Faro LS 880HE. Assumed: distance and angles.
    """
    places = [(-135.0, STOVE_DISTANCE, 1.5), (-90.0, STOVE_DISTANCE, 1.5), (-45.0, STOVE_DISTANCE, 1.5)]
    return stand_around(places, spacing=spacing, surface_radius=0.4)


def attic_stations(*, spacing: float = 0.002) -> tuple[Station, ...]:
    """Return the eight stations of the attic sculpture: four sides from two heights.

    Paper 001, section 4.1: eight scans from two height levels, no further than 5 m, a quarter of the full resolution
    of a Faro Photon 120, 2 mm mean spacing. Assumed: the heights and angles; the upper four stand between the lower.
    """
    low = [(angle, ATTIC_DISTANCE, 1.4) for angle in (-90.0, 0.0, 90.0, 180.0)]
    high = [(angle, ATTIC_DISTANCE, 2.9) for angle in (-45.0, 45.0, 135.0, -135.0)]
    return stand_around(low + high, spacing=spacing, surface_radius=0.3)
