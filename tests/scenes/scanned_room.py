"""A room whose walls are scanned by formula: directions at random, ranges with cyclic error and noise."""

import numpy as np

from monitor.simulation.instruments import INSTRUMENTS
from monitor.simulation.scanner import cyclic_error
from projects.model import PointCloud, Scan

FARO = INSTRUMENTS["faro-ls880"]
STATION = np.array([2.6, 2.2, 1.6])
ROOM = np.array([7.0, 6.0, 3.5])


def scan_room(rng, n_points=25_000, noise=0.6e-3, instrument=FARO, relief=None):
    """Return a scan of a room of 7 x 6 x 3.5 m from inside it.

    `relief` (wall 0 to 5, points on it (m, 2)) -> (m,) m moves its surface towards the scanner.
    """
    azimuth, height = rng.uniform(0, 2 * np.pi, n_points), rng.uniform(np.radians(-65), np.radians(88), n_points)
    beams = np.c_[np.cos(height) * np.cos(azimuth), np.cos(height) * np.sin(azimuth), np.sin(height)]
    reach = np.where(beams > 0, ROOM - STATION, -STATION) / beams
    axis, rows = reach.argmin(axis=1), np.arange(n_points)
    ranges, slopes = reach[rows, axis], np.abs(beams[rows, axis])
    wall = 2 * axis + (beams[rows, axis] > 0)
    if relief is not None:
        for number in range(6):
            on = wall == number
            aside = np.delete(beams[on] * ranges[on, None], number // 2, axis=1)
            ranges[on] -= relief(number, aside) / slopes[on]
    measured = ranges + cyclic_error(instrument, ranges) + rng.normal(0, noise, n_points)
    return Scan("room", PointCloud(beams * measured[:, None]), np.eye(4))


def uneven_plaster(rng, rms, length):
    """Return the relief of walls, isotropic waves about `length` [m] long and `rms` [m] high, new for each wall."""

    def relief(_wall, aside):
        angle, size = rng.uniform(0, 2 * np.pi, 20), 2 * np.pi / length * np.exp(rng.uniform(-0.7, 0.7, 20))
        phases = aside @ (size * np.array([np.cos(angle), np.sin(angle)])) + rng.uniform(0, 2 * np.pi, 20)
        return rms * np.sqrt(2 / 20) * np.cos(phases).sum(axis=1)

    return relief
