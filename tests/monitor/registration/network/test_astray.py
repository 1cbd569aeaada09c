"""A scan whose pose is far off, while the others fit: refused by name, never built upon."""

import numpy as np
import pytest
from network_of_caps import bumpy_cap, displaced

from monitor.registration.network.adjustment import adjust_scans
from monitor.registration.network.astray import find_astray
from monitor.registration.network.overlaps import PairFit
from projects.transforms import perturb


def caps_with(rng: np.random.Generator, error: np.ndarray) -> list:
    """Return four scans of a ball, the second with an error of its pose about its station 2 m off."""
    turns = np.arange(4) * np.pi / 2
    clouds = [bumpy_cap(rng, turn, 0.0003) for turn in turns]
    station = np.array([2.0 * np.cos(turns[1]), 2.0 * np.sin(turns[1]), 0.0])
    clouds[1] = displaced(clouds[1], perturb(np.eye(4), station, error))
    return clouds


def test_a_scan_four_degrees_off_is_refused_by_name(rng):
    """The others were fitted, this one stood 140 mm beside the object, and that was told as a part that moved."""
    found = adjust_scans(caps_with(rng, np.array([0.0, 0.0, np.radians(4.0), 0.0, 0.0, 0.0])))
    assert not found.converged
    assert found.reason.startswith("scan 2 fits none that it overlaps")
    assert "the others fit to 0." in found.reason


def test_an_error_within_reach_is_still_bettered(rng):
    found = adjust_scans(caps_with(rng, np.array([0.0, 0.0, 0.002, 0.001, 0.002, 0.0])))
    assert found.applied, found.reason


def fit(first: int, second: int, sigma: float, bias: float = 0.0) -> PairFit:
    return PairFit(first, second, 500, bias, sigma, bias, sigma)


@pytest.mark.parametrize(
    ("pairs", "astray"),
    [
        ([fit(0, 1, 0.0003), fit(1, 2, 0.0106)], [2]),
        ([fit(0, 1, 0.0003), fit(1, 2, 0.0003, bias=-0.0106)], [2]),
        ([fit(0, 1, 0.0003), fit(1, 2, 0.0029)], []),  # five to ten times: far away, steep, or rough
        ([fit(0, 1, 0.0003), fit(1, 2, 0.0106), fit(0, 2, 0.0004)], []),  # one pair of two fits
        ([fit(0, 1, 0.0106)], []),  # which of two is off, and by what measure?
        ([fit(0, 1, 0.0), fit(1, 2, 0.0003)], []),  # a copy fits to nothing, less than the points lie apart
        ([fit(0, 1, 0.0003), fit(1, 2, float("nan"))], []),  # no pair is left: told as overlapping no other
    ],
)
def test_astray_is_what_fits_nothing_where_the_others_fit(pairs, astray):
    assert find_astray(pairs, 3, spacing=0.002, noise=np.zeros(3)).tolist() == astray


def test_a_far_and_coarse_scan_fits_as_well_as_it_measures(rng):
    pairs = [fit(0, 1, 0.0003), fit(1, 2, 0.0050)]
    assert find_astray(pairs, 3, 0.002, np.array([0.0003, 0.0003, 0.0045])).tolist() == []
    assert find_astray(pairs, 3, 0.002, np.array([0.0003, 0.0003, 0.0011])).tolist() == [2]
    clouds = caps_with(rng, np.zeros(6))
    clouds[2] = bumpy_cap(rng, np.pi, 0.006)  # 6 mm of noise, the others 0.3
    found = adjust_scans(clouds)
    assert "fits none" not in found.reason
