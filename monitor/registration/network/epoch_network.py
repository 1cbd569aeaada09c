"""Several epochs in one adjustment: where the object stood at each of them, in the frame of the first.

In: registrations between pairs of epochs, each with its covariance. Out: one pose an epoch, adjusted by least squares,
its covariance, and how well the links close. Every epoch against the first and against the one before it makes a net
with one loop an epoch, which shows a link that is wrong. What an epoch's own surface errs by is in all of its links: it
closes every loop, and no number of links averages it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import nnls
from scipy.stats import chi2

from monitor.registration.motion.covariance import about
from projects.errors import RegistrationError
from projects.model import Floats, Registration
from projects.transforms import apply, invert, motion_about, perturb

N_ITERATIONS = 10
STEP = 1e-6  # rad and m, of the derivatives by differences


@dataclass(frozen=True)
class EpochLink:
    """A registration between two epochs: `source` onto `target`, numbers of epochs."""

    target: int
    source: int
    registration: Registration


@dataclass(frozen=True)
class EpochNetwork:
    """Poses of n epochs.

    Attributes
    ----------
    T_first_epoch : (n, 4, 4), epoch coordinates to those of the first; where the object's own frame is concerned, its
        motion since the first epoch is the inverse.
    covariance : (n, 6, 6) of (w, t) about `centre` (3,) in the first epoch's frame, rad and m; zero for the first.
    joint : (6 (n - 1), 6 (n - 1)), the same of all but the first together.
    misfit : (links,), by how much each link departs from the adjusted poses, in sigmas (square root of its chi-square
        over six); NaN of links that tell nothing of their own.
    chi2, freedom, probability : of all misfits; NaN without loops. Where chi2 exceeds the freedom, the covariance is
        raised by their ratio; where it falls short, the ratio is the share of the links' variance that is their own,
        and the rest is that of the epochs, which all links of an epoch have in common.
    """

    T_first_epoch: Floats
    covariance: Floats
    joint: Floats
    centre: Floats
    misfit: Floats
    chi2: float
    freedom: int
    probability: float


def adjust_network(links: Sequence[EpochLink], n_epochs: int) -> EpochNetwork:
    """Return the poses that fit all links best.

    A link whose covariance is zero tells nothing of its own: the frames of its epochs alone hold it. Epochs that no
    other link reaches from the first stay where such links put them, of zero covariance, as the frames are not in it.

    Raises
    ------
    RegistrationError
        Where a link did not converge, or an epoch hangs on none.
    """
    require_connected(links, n_epochs)
    centre = links[0].registration.centre
    poses = first_poses(links, n_epochs)
    telling = [link for link in links if link.registration.covariance.any()]
    reached = reach_from_first(telling, n_epochs)
    telling = [link for link in telling if link.source in reached]
    rows = np.concatenate([np.arange(0), *(np.arange(6 * k - 6, 6 * k) for k in sorted(reached - {0}))])
    block = np.ix_(rows, rows)
    weights = [np.linalg.pinv(link.registration.covariance, rcond=1e-15, hermitian=True)
               if link.source in reached else np.zeros((6, 6)) for link in links]  # fmt: skip
    for _ in range(N_ITERATIONS):
        normal, right = normal_equations(links, weights, poses, centre)
        delta = np.zeros_like(right)
        delta[rows] = np.linalg.solve(normal[block], right[rows])
        delta = delta.reshape(-1, 6)
        poses[1:] = [perturb(T, centre, d) for T, d in zip(poses[1:], delta, strict=True)]
        if np.abs(delta).max() < 1e-12:
            break
    normal, _ = normal_equations(links, weights, poses, centre)
    squares = np.array([r @ w @ r for r, w in zip(misfits(links, poses), weights, strict=True)])
    freedom = 6 * (len(telling) - (len(reached) - 1))
    ratio = float(squares.sum()) / freedom if freedom else 1.0
    joint = np.zeros_like(normal)
    if ratio:
        joint[block] = ratio * np.linalg.inv(normal[block])
    if ratio < 1.0:
        joint[block] += (1.0 - ratio) * common_errors(telling, poses, centre)[block]
    covariance = np.zeros((n_epochs, 6, 6))
    for k in range(1, n_epochs):
        covariance[k] = joint[6 * k - 6 : 6 * k, 6 * k - 6 : 6 * k]
    misfit = np.where([w.any() for w in weights], np.sqrt(squares / 6.0), np.nan)
    return EpochNetwork(
        poses, covariance, joint, centre, misfit, float(squares.sum()), freedom,
        float(chi2.sf(squares.sum(), freedom)) if freedom else float("nan"),
    )  # fmt: skip


def common_errors(links: Sequence[EpochLink], poses: Floats, centre: Floats) -> Floats:
    """Return the covariance (6 (n - 1), 6 (n - 1)) about `centre` of the poses of all epochs but the first where all
    that the links err by is the epochs' own: each pose by its epoch's, and all of them by what the first errs by."""
    of_link = [_in_first_frame(link, poses[link.target], centre) for link in links]
    usual = np.diag(np.mean(of_link, axis=0))
    sizes = np.array([np.mean(np.diag(C) / usual) for C in of_link])
    takes_part = np.array([[k in (link.target, link.source) for k in range(len(poses))] for link in links])
    # Each link as a share of its own: those of a bad epoch, off by more than others are large, would decide alone.
    of_epoch = nnls(takes_part / sizes[:, None], np.ones(len(sizes)))[0]
    own = []
    for k in range(len(poses)):
        shares = [
            of_epoch[k] / max(of_epoch[link.target] + of_epoch[link.source], 1e-300) * C
            for link, C, takes in zip(links, of_link, takes_part[:, k], strict=True) if takes
        ]  # fmt: skip
        own.append(np.mean(shares, axis=0) if shares else np.zeros((6, 6)))
    n = len(poses) - 1
    return np.asarray(block_diag(*own[1:]) + np.kron(np.ones((n, n)), own[0]))


def _in_first_frame(link: EpochLink, T_first_target: Floats, centre: Floats) -> Floats:
    """Return the covariance (6, 6) of a link in the first epoch's frame about `centre`."""
    turn = block_diag(T_first_target[:3, :3], T_first_target[:3, :3])
    own = apply(T_first_target, link.registration.centre)
    return about(turn @ link.registration.covariance @ turn.T, centre - own)


def require_connected(links: Sequence[EpochLink], n_epochs: int) -> None:
    """Raise `RegistrationError` for a link without a motion, or an epoch that no link reaches from the first."""
    for link in links:
        if not link.registration.converged or not np.isfinite(link.registration.covariance).all():
            raise RegistrationError(
                f"epochs {link.target + 1} and {link.source + 1} were not registered ({link.registration.reason}); "
                "a network needs links that converged"
            )
    reached = reach_from_first(links, n_epochs)
    if len(reached) < n_epochs:
        missing = sorted(set(range(n_epochs)) - reached)
        raise RegistrationError(f"no link reaches epoch {missing[0] + 1} of {n_epochs}; compare it with another one")


def reach_from_first(links: Sequence[EpochLink], n_epochs: int) -> set[int]:
    """Return the numbers of the epochs that links reach from the first, and its own."""
    reached = {0}
    for _ in range(n_epochs):
        reached |= {b for link in links for a, b in _both_ways(link) if a in reached}
    return reached


def _both_ways(link: EpochLink) -> tuple[tuple[int, int], tuple[int, int]]:
    return (link.target, link.source), (link.source, link.target)


def first_poses(links: Sequence[EpochLink], n_epochs: int) -> Floats:
    """Return poses (n, 4, 4) put together link by link from the first epoch."""
    poses = np.full((n_epochs, 4, 4), np.nan)
    poses[0] = np.eye(4)
    for _ in range(n_epochs):
        for link in links:
            T = link.registration.T_target_source
            if np.isnan(poses[link.source, 0, 0]):
                poses[link.source] = poses[link.target] @ T
            if np.isnan(poses[link.target, 0, 0]):
                poses[link.target] = poses[link.source] @ invert(T)
    return poses


def misfits(links: Sequence[EpochLink], poses: Floats) -> list[Floats]:
    """Return for each link the motion (6,) about its centre that leads from what it says to what the poses say."""
    found = []
    for link in links:
        motion = link.registration
        step = invert(poses[link.target]) @ poses[link.source] @ invert(motion.T_target_source)
        found.append(motion_about(step, motion.centre))
    return found


def normal_equations(links: Sequence[EpochLink], weights: Sequence[Floats], poses: Floats,
                     centre: Floats) -> tuple[Floats, Floats]:  # fmt: skip
    """Return the normal matrix and right side of the motions (6 each, about `centre`) of all epochs but the first."""
    n = 6 * (len(poses) - 1)
    normal, right = np.zeros((n, n)), np.zeros(n)
    for link, weight in zip(links, weights, strict=True):
        misfit = misfits([link], poses)[0]
        rows = np.zeros((6, n))
        for k in {link.target, link.source} - {0}:
            for axis in range(6):
                moved = poses.copy()
                moved[k] = perturb(poses[k], centre, STEP * np.eye(6)[axis])
                rows[:, 6 * k - 6 + axis] = (misfits([link], moved)[0] - misfit) / STEP
        normal += rows.T @ weight @ rows
        right -= rows.T @ weight @ misfit
    return normal, right
