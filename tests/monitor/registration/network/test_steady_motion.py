"""Whether an object moves on as a whole: against least squares by hand, and against simulated truth."""

import datetime
import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from monitor.registration.motion.held import Frames
from monitor.registration.network.epoch_network import EpochLink, adjust_network
from monitor.registration.network.steady_motion import fit_steady_motion
from monitor.through_time import DAYS_PER_YEAR, tell_steady_motion
from projects.errors import ParameterError, ShapeError
from projects.model import EpochRecord, Floats, Registration
from projects.transforms import invert, perturb

DAYS = (0, 400, 700, 1500, 2100)
EPOCHS = [EpochRecord("figure", f"e{k}", datetime.date(2019, 5, 1) + datetime.timedelta(d)) for k, d in enumerate(DAYS)]
YEARS = np.array(DAYS[1:]) / DAYS_PER_YEAR
CENTRE = np.array([0.4, -0.2, 1.1])


def spread(rng: np.random.Generator, sigma: float) -> Floats:
    a = sigma * rng.normal(size=(6, 6))
    return a @ a.T + 0.1 * sigma**2 * np.eye(6)


def of_frames(size: float) -> list[Frames | None]:
    return [Frames(size**2 * np.diag([0.2, 0.3, 0.1, 1.0, 2.0, 0.5]), CENTRE) for _ in EPOCHS]


def observe(rng: np.random.Generator, rate: Floats, frames: list[Frames | None]) -> dict[str, object]:
    """Link all epochs of an object that moves at `rate`, each in a frame that is off by what `frames` say."""
    moved = [np.eye(4)] + [perturb(np.eye(4), CENTRE, rate * t) for t in YEARS]
    off = [perturb(np.eye(4), CENTRE, rng.multivariate_normal(np.zeros(6), f.covariance)) for f in frames if f]
    stood = [o @ m for o, m in zip(off, moved, strict=True)]  # of the object, as the coordinates of each epoch say
    links = []
    for a, b in [(0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4)]:
        covariance = spread(rng, 2e-5)
        T = perturb(stood[a] @ invert(stood[b]), CENTRE, rng.multivariate_normal(np.zeros(6), covariance))
        links.append(EpochLink(a, b, Registration(T, covariance, CENTRE, True)))
    return dict(tell_steady_motion(adjust_network(links, len(EPOCHS)), EPOCHS, frames)["steady_motion"])


def test_two_epochs_and_an_unsure_first_one_by_hand() -> None:
    (r, s), t, d = (3e-4, 1e-4), np.array([1.0, 3.0]), np.array([[0.0] * 5 + [1.1e-3], [0.0] * 5 + [2.0e-3]])
    covariance = np.kron(r**2 * np.ones((2, 2)) + s**2 * np.eye(2), np.eye(6))
    found = fit_steady_motion(t, d, covariance)
    # unknown where the first one truly stood, 0 with sigma r, and the rate
    normal = np.array([[1 / r**2 + 2 / s**2, t.sum() / s**2], [t.sum() / s**2, (t**2).sum() / s**2]])
    offset, rate = np.linalg.solve(normal, [d[:, 5].sum() / s**2, t @ d[:, 5] / s**2])
    assert found.rate == pytest.approx([0.0] * 5 + [rate], rel=1e-9, abs=1e-15)
    assert found.covariance[5, 5] == pytest.approx(np.linalg.inv(normal)[1, 1], rel=1e-9)
    left = offset**2 / r**2 + ((d[:, 5] - offset - rate * t) ** 2).sum() / s**2
    assert found.p_fit == pytest.approx(chi2.sf(left, 6), rel=1e-9)
    assert found.p_shift == pytest.approx(chi2.sf(rate**2 / found.covariance[5, 5], 3), rel=1e-9)
    assert found.p_rate == pytest.approx(chi2.sf(rate**2 / found.covariance[5, 5], 6), rel=1e-9)
    assert found.p_turn == pytest.approx(1.0)


def test_the_true_rate_lies_within_its_ellipsoid_and_epochs_off_a_line_by_chance_fit(rng: np.random.Generator) -> None:
    """The frame of the first epoch is in all differences: as one of each by itself, 65 % would be inside."""
    rate, inside, fits = np.array([1e-5, -2e-5, 0.0, 0.0, 5e-5, -1e-4]), 0, []
    for _ in range(200):
        told = observe(rng, rate, of_frames(1e-4))
        error = np.asarray(told["rate"]) - rate
        inside += error @ np.linalg.solve(np.asarray(told["covariance"]), error) < chi2.ppf(0.95, 6)
        fits.append(told["p_fit"])
    assert inside / 200 == pytest.approx(0.95, abs=0.045)
    raised = 0.03  # by links' chi2, where it raises their covariance
    assert np.mean(fits) == pytest.approx(0.5, abs=4 * np.sqrt(1 / 12 / 200) + raised)


def test_an_object_at_rest_seldom_moves_steadily_and_one_that_jumped_does_not(rng: np.random.Generator) -> None:
    still = [observe(rng, np.zeros(6), of_frames(1e-4))["p_rate"] for _ in range(200)]
    assert np.mean(np.array(still) < 0.05) == pytest.approx(0.05, abs=0.045)
    steady = observe(rng, np.array([0.0, 0.0, 0.0, 0.0, 0.0, -1e-3]), of_frames(1e-5))
    assert steady["p_shift"] < 1e-6 < steady["p_fit"]
    assert np.asarray(steady["rate"])[5] == pytest.approx(-1e-3, abs=5e-5)
    jump = np.zeros((4, 6))
    jump[2:, 5] = 1e-3
    assert fit_steady_motion(YEARS, jump, 1e-10 * np.eye(24)).p_fit < 1e-6


def test_motions_turn_the_object_about_the_centre_the_way_that_it_turned(rng: np.random.Generator) -> None:
    rate = np.array([0.0, 2e-4, 0.0, 1e-3, 0.0, 0.0])
    told = observe(rng, rate, of_frames(1e-6))
    assert np.asarray(told["rate"]) == pytest.approx(rate, abs=4e-5)
    assert np.asarray(told["centre"]) == pytest.approx(CENTRE)
    late = perturb(np.eye(4), CENTRE, rate * 5.0)
    assert Rotation.from_matrix(late[:3, :3]).as_rotvec() == pytest.approx(5.0 * rate[:3])


def test_what_is_told_is_a_record_that_comes_back_as_it_was(rng: np.random.Generator) -> None:
    told = observe(rng, np.zeros(6), of_frames(1e-5))
    assert json.loads(json.dumps(told)) == told
    assert np.shape(told["covariance"]) == (6, 6)


def test_nothing_is_told_where_frames_are_not_known(rng: np.random.Generator) -> None:
    links = [EpochLink(0, k, Registration(np.eye(4), spread(rng, 1e-5), CENTRE, True)) for k in range(1, 5)]
    network = adjust_network(links, 5)
    known = of_frames(1e-5)
    assert tell_steady_motion(network, EPOCHS, [None, *known[1:]]) == {}
    assert tell_steady_motion(network, EPOCHS, [known[0], None, None, None, known[4]]) == {}
    told = tell_steady_motion(network, EPOCHS, [known[0], None, known[2], None, known[4]])["steady_motion"]
    assert told["epochs"] == 3
    assert told["rate"] == pytest.approx(np.zeros(6), abs=1e-15)
    none = replace(network, joint=-network.joint)
    assert tell_steady_motion(none, EPOCHS, of_frames(1e-6)) == {}


def test_years_and_shapes_that_make_no_series_are_refused() -> None:
    with pytest.raises(ParameterError, match="two or more"):
        fit_steady_motion(np.array([1.0]), np.zeros((1, 6)), np.eye(6))
    with pytest.raises(ParameterError, match="ascending"):
        fit_steady_motion(np.array([2.0, 1.0]), np.zeros((2, 6)), np.eye(12))
    with pytest.raises(ShapeError, match=r"\(12, 12\) are needed"):
        fit_steady_motion(np.array([1.0, 2.0]), np.zeros((2, 6)), np.eye(6))
