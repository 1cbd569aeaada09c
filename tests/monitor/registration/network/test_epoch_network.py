"""Epochs in one adjustment: against least squares by hand, against simulated truth, and with one wrong link."""

import datetime
import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from monitor.registration.motion.held import Frames
from monitor.registration.network.epoch_network import EpochLink, adjust_network
from monitor.registration.network.steady_motion import fit_steady_motion
from monitor.through_time import tell_network, tell_steady_motion, without_frames
from projects.errors import RegistrationError
from projects.model import EpochRecord, Floats, Registration
from projects.transforms import apply, invert, motion_about, perturb


def pose(rng: np.random.Generator, turn: float = 0.02, shift: float = 0.01) -> Floats:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(rng.normal(scale=turn, size=3)).as_matrix()
    T[:3, 3] = rng.normal(scale=shift, size=3)
    return T


def random_covariance(rng: np.random.Generator) -> Floats:
    a = rng.normal(size=(6, 6)) * np.repeat([2e-5, 3e-5], 3)[:, None]
    return a @ a.T + np.diag(np.repeat([1e-10, 1e-10], 3))


def measured(rng: np.random.Generator, poses: Floats, target: int, source: int) -> EpochLink:
    covariance, centre = random_covariance(rng), rng.normal(size=3)
    truth = invert(poses[target]) @ poses[source]
    # the covariance is of the step from what was measured to the truth, to first order that of the error
    T = perturb(truth, centre, rng.multivariate_normal(np.zeros(6), covariance))
    return EpochLink(target, source, Registration(T, covariance, centre, True))


def test_two_links_of_shifts_alone_are_weighed_by_their_variances() -> None:
    def shifted(x: float, sigma: float) -> EpochLink:
        T = np.eye(4)
        T[0, 3] = x
        return EpochLink(0, 1, Registration(T, np.eye(6) * sigma**2, np.zeros(3), True))

    network = adjust_network([shifted(1.0e-3, 1e-4), shifted(1.6e-3, 2e-4)], 2)
    assert network.T_first_epoch[1, 0, 3] == pytest.approx((1.0e-3 * 4 + 1.6e-3) / 5, rel=1e-6)
    # 6e-4 against sqrt(1 + 4) e-4, squared, over one axis of six
    assert network.chi2 == pytest.approx(36.0 / 5.0, rel=1e-6)
    assert network.freedom == 6
    assert np.sqrt(network.covariance[1, 3, 3]) == pytest.approx(np.sqrt(7.2 / 6.0 / 1.25) * 1e-4, rel=1e-6)


def test_poses_and_their_covariances_hold_the_truth(rng: np.random.Generator) -> None:
    inside, statistics = 0, []
    for _ in range(100):
        poses = np.stack([np.eye(4), *(pose(rng) for _ in range(3))])
        links = [measured(rng, poses, i, j) for i, j in itertools.combinations(range(4), 2)]
        network = adjust_network(links, 4)
        statistics.append(network.chi2)
        step = poses[3] @ invert(network.T_first_epoch[3])
        error = np.concatenate([Rotation.from_matrix(step[:3, :3]).as_rotvec(),
                                apply(step, network.centre) - network.centre])  # fmt: skip
        inside += error @ np.linalg.inv(network.covariance[3]) @ error < chi2.ppf(0.95, 6)
    assert network.freedom == 18
    assert np.mean(statistics) == pytest.approx(18.0, abs=4 * np.sqrt(36.0 / 100))
    assert 90 <= inside <= 100  # 95 +- 2.2, and a little more where chi2 raised the covariance


def test_what_frames_may_differ_by_is_told_once_and_not_averaged_over_links(rng: np.random.Generator) -> None:
    """The frame of an epoch is one in all its links: by three links 2 mm would seem sure to 1.6, by more to 1.3."""
    poses, own, of_frames = np.stack([np.eye(4)] * 3), np.diag([1e-5] * 3 + [1e-5] * 3) ** 2, 4e-6 * np.eye(6)
    poses[1:, 0, 3] = 1e-3
    frames = Frames(of_frames, np.zeros(3))
    links = [
        EpochLink(i, j, Registration(invert(poses[i]) @ poses[j], own + of_frames, np.zeros(3), True))
        for i, j in itertools.combinations(range(3), 2)
    ]
    bare = [without_frames(link, frames) for link in links]
    assert bare[0].registration.covariance == pytest.approx(own)
    assert without_frames(links[0], None) is links[0]
    epochs = [EpochRecord("stair", f"e{k}", datetime.date(2020 + k, 5, 1)) for k in range(3)]
    motions, closures = tell_network(adjust_network(bare, 3), bare, epochs, [frames, None])
    # the loop closes: what the links err by is the epochs' own, and three links do not make it sure to 0.82 of itself
    assert motions["sigma_shift_m"][0] == pytest.approx(np.sqrt(1e-10 + 4e-6), rel=1e-4)
    assert motions["sigma_shift_m"][1] == pytest.approx(1e-5, rel=1e-4)
    assert motions["probability_unmoved"][0] > 0.9  # 1 mm in frames known to 2 mm
    assert np.isnan(motions["probability_unmoved"][1])  # of frames of which nothing is known
    assert len(closures) == 3


def test_the_motion_of_an_object_that_turned_is_as_sure_as_it_scatters() -> None:
    """What undoes a quarter turn has x where the motion has y."""
    quarter = perturb(np.eye(4), np.zeros(3), np.array([0.0, 0.0, np.pi / 2, 0.3, 0.0, 0.0]))
    of_link = np.diag([1e-4, 1e-4, 1e-4, 1e-3, 1e-4, 2e-4]) ** 2
    links = [EpochLink(0, k, Registration(quarter, k * of_link, np.zeros(3), True)) for k in (1, 2)]
    epochs = [EpochRecord("figure", f"e{k}", datetime.date(2020 + k, 5, 1)) for k in range(3)]
    network, frames = adjust_network(links, 3), Frames(1e-16 * np.eye(6), np.zeros(3))
    motions = tell_network(network, links, epochs, [frames] * 2)[0]
    assert motions.loc[0, ["x_m", "y_m"]].tolist() == pytest.approx([0.0, 0.3], abs=1e-12)
    assert motions.loc[0, ["sigma_x_m", "sigma_y_m", "sigma_z_m"]].tolist() == pytest.approx([1e-4, 1e-3, 2e-4])
    assert motions["sigma_shift_m"][0] == pytest.approx(1e-3)
    steady = tell_steady_motion(network, epochs, [frames] * 3)["steady_motion"]
    assert np.sqrt(steady["covariance"][4][4] / steady["covariance"][3][3]) == pytest.approx(10.0, rel=1e-3)


@pytest.mark.parametrize("told", [(), ((0, 1),), ((0, 1), (0, 2))])
def test_frames_that_alone_hold_links_are_told_once(told: tuple[tuple[int, int], ...]) -> None:
    """What no shape tells stays as the frames say, to 2 mm: they are not averaged, nor is anything singular."""
    frames, own, pairs = Frames(4e-6 * np.eye(6), np.zeros(3)), 1e-8 * np.eye(6), [(0, 1), (0, 2), (1, 2)]
    given = [Registration(np.eye(4), frames.covariance + own * (pair in told), np.zeros(3), True) for pair in pairs]
    bare = [without_frames(EpochLink(*pair, one), frames) for pair, one in zip(pairs, given, strict=True)]
    network = adjust_network(bare, 3)
    assert network.T_first_epoch == pytest.approx(np.stack([np.eye(4)] * 3))
    for k in (1, 2):
        assert network.covariance[k] == pytest.approx(own * ((0, k) in told), rel=1e-6, abs=1e-14)
    epochs = [EpochRecord("stair", f"e{k}", datetime.date(2020 + k, 5, 1)) for k in range(3)]
    motions = tell_network(network, bare, epochs, [frames, frames])[0]
    assert motions["sigma_shift_m"].tolist() == pytest.approx([2e-3] * 2, rel=2e-3)
    assert network.freedom == 0
    assert np.isnan(network.misfit).tolist() == [pair not in told for pair in pairs]  # nothing to fit or not


def test_what_an_epoch_errs_by_in_all_its_links_is_not_averaged(rng: np.random.Generator) -> None:
    """Each epoch's surface errs, one of them three times as much, and its links with it: every loop closes, and the
    95 % ellipsoids of links taken for independent hold the truth in three of four cases."""
    sizes, inside, moves = np.array([1.0, 1.0, 3.0, 1.0, 1.0]), [], []
    shape = random_covariance(rng)
    pairs = [(0, k) for k in range(1, 5)] + [(k, k + 1) for k in range(1, 4)]
    for _ in range(100):
        errors = rng.multivariate_normal(np.zeros(6), shape, 5) * sizes[:, None]
        links = []
        for a, b in pairs:
            both, alone = (sizes[a] ** 2 + sizes[b] ** 2) * shape, 0.1  # of the variance, each link's own
            step = np.sqrt(1.0 - alone) * (errors[b] - errors[a])
            step = step + rng.multivariate_normal(np.zeros(6), alone * both)
            T = perturb(np.eye(4), np.zeros(3), step)
            links.append(EpochLink(a, b, Registration(T, both, np.zeros(3), True)))
        network = adjust_network(links, 5)
        found = np.array([motion_about(T, network.centre) for T in network.T_first_epoch[1:]])
        inside += [e @ np.linalg.solve(C, e) < chi2.ppf(0.95, 6)
                   for e, C in zip(found, network.covariance[1:], strict=True)]  # fmt: skip
        moves.append(fit_steady_motion(np.arange(1.0, 5.0), found, network.joint).p_rate < 0.05)
    assert np.mean(inside) == pytest.approx(0.95, abs=0.04)  # 95 +- 1.5 %; 74 % as links of their own
    assert np.mean(moves) < 0.13  # of an object at rest; 30 % as links of their own


def test_links_of_a_bad_epoch_take_nothing_off_what_the_others_err_by() -> None:
    """The third of five epochs errs by five times as much: the first and the last were told to err by nothing of their
    own, and how the last stands to a third of what any of its links says."""
    sigmas = {(0, 1): 1.11, (0, 2): 3.96, (1, 2): 3.88, (0, 3): 1.09, (2, 3): 5.5, (0, 4): 0.94, (3, 4): 0.88}
    links = [
        EpochLink(a, b, Registration(np.eye(4), (3e-5 * sigma) ** 2 * np.eye(6), np.zeros(3), True))
        for (a, b), sigma in sigmas.items()
    ]
    network = adjust_network(links, 5)
    told = np.sqrt(network.covariance[:, 5, 5]) / 3e-5
    for k in (1, 2, 3, 4):
        assert 0.8 * sigmas[0, k] < told[k] < 1.2 * sigmas[0, k]


def test_wrong_link_is_the_one_that_does_not_close(rng: np.random.Generator) -> None:
    poses = np.stack([np.eye(4), *(pose(rng) for _ in range(4))])
    links = [measured(rng, poses, i, j) for i, j in itertools.combinations(range(5), 2)]
    bad = links[4].registration
    T = perturb(bad.T_target_source, bad.centre, np.array([0, 0, 0, 3e-3, 0, 0]))
    links[4] = EpochLink(links[4].target, links[4].source, Registration(T, bad.covariance, bad.centre, True))
    network = adjust_network(links, 5)
    assert network.probability < 1e-6
    assert int(np.argmax(network.misfit)) == 4
    assert network.misfit[4] > 3.3  # sigmas: 0.1 % by chance


def test_epochs_without_links_or_motions_are_refused(rng: np.random.Generator) -> None:
    poses = np.stack([np.eye(4), pose(rng), pose(rng)])
    link = measured(rng, poses, 0, 1)
    with pytest.raises(RegistrationError, match="epoch 3 of 3"):
        adjust_network([link], 3)
    lost = Registration(np.eye(4), np.full((6, 6), np.nan), np.zeros(3), False, "no overlap")
    with pytest.raises(RegistrationError, match="no overlap"):
        adjust_network([link, EpochLink(1, 2, lost)], 3)
