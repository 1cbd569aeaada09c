"""Rigid transforms as (4, 4) matrices whose name says their direction: `T_target_source` maps source to target."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from projects.errors import ParameterError
from projects.model import Floats


def apply(T_target_source: Floats, points: Floats) -> Floats:
    """Return points (n, 3) or (3,) [m] of the source frame in the target frame."""
    return points @ T_target_source[:3, :3].T + T_target_source[:3, 3]


def rotate(T_target_source: Floats, vectors: Floats) -> Floats:
    """Return directions (n, 3) or (3,) of the source frame in the target frame."""
    return vectors @ T_target_source[:3, :3].T


def invert(T_target_source: Floats) -> Floats:
    """Return T_source_target of a rigid transform."""
    inverse = np.eye(4)
    inverse[:3, :3] = T_target_source[:3, :3].T
    inverse[:3, 3] = -T_target_source[:3, :3].T @ T_target_source[:3, 3]
    return inverse


def cross_matrix(vector: Floats) -> Floats:
    """Return [v] with [v] x = v cross x, (3, 3)."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation_from_vector(w: Floats) -> Floats:
    """Return exp([w]) (3, 3) for a rotation vector [rad] (Rodrigues)."""
    angle = float(np.linalg.norm(w))
    W = cross_matrix(w)
    if angle < 1e-8:
        return np.eye(3) + W + 0.5 * W @ W
    return np.eye(3) + np.sin(angle) / angle * W + (1.0 - np.cos(angle)) / angle**2 * W @ W


def perturb(T_target_source: Floats, centre: Floats, delta: Floats) -> Floats:
    """Return the transform followed by x -> c + exp([w]) (x - c) + t, with delta = (w, t) [rad, m], c in the target."""
    step = np.eye(4)
    step[:3, :3] = rotation_from_vector(np.asarray(delta[:3], dtype=float))
    step[:3, 3] = centre - step[:3, :3] @ centre + delta[3:]
    return step @ T_target_source


def motion_about(T_target_source: Floats, centre: Floats) -> Floats:
    """Return the motion (w, t) (6,) [rad, m] of a transform about a point: the delta that `perturb` takes."""
    from scipy.spatial.transform import Rotation  # takes half a second to load, which readers of files do without

    turn = Rotation.from_matrix(T_target_source[:3, :3]).as_rotvec()
    return np.concatenate([turn, apply(T_target_source, centre) - centre])


@dataclass(frozen=True)
class Motion:
    """A motion as `motion_about` tells it, `vector` (6,) of (w, t), and the `covariance` (6, 6) of these, rad and m."""

    vector: Floats
    covariance: Floats


def undone_motion(T_target_source: Floats, covariance: Floats, centre: Floats) -> Motion:
    """Return the motion about `centre` (3,), in the target's frame, that a transform undoes, its inverse, and how well
    it is known where the transform is known to `covariance` (6, 6) of the delta of `perturb` about there."""
    rows = rows_of_inverse(T_target_source)
    return Motion(motion_about(invert(T_target_source), centre), np.asarray(rows @ covariance @ rows.T))


def rows_of_inverse(T_target_source: Floats) -> Floats:
    """Return J (6, 6) that turns the delta (w, t) of `perturb` about a point into the change of what `motion_about`
    tells there of the inverse.

    The inverse, of rotation R = exp([v]), becomes R exp(-[w]) = exp([v - J_r(v)^-1 w]) and takes the point R t less
    far, with J_r(v)^-1 = I + [v] / 2 + (1 - (a / 2) cot(a / 2)) [v]^2 / a^2 for the angle a = |v| (Sola et al. 2018,
    Eq. 144).
    """
    inverse = invert(T_target_source)
    turn = motion_about(inverse, np.zeros(3))[:3]
    angle = float(np.linalg.norm(turn))
    V = cross_matrix(turn)
    of_square = (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / angle**2 if angle > 1e-8 else 1.0 / 12.0
    J = np.zeros((6, 6))
    J[:3, :3] = -(np.eye(3) + 0.5 * V + of_square * V @ V)
    J[3:, 3:] = -inverse[:3, :3]
    return J


def require_rigid(matrix: Floats, what: str) -> Floats:
    """Return `matrix` if it is a proper rigid transform to 1e-4, with its rotation made exact; raise otherwise.

    A matrix that scales (a PTX header can), mirrors or was written column by column is refused as what it is.
    """
    matrix = np.asarray(matrix, dtype=np.float64)
    if matrix.shape == (4, 4) and matrix[:3, 3].tolist() == [0, 0, 0] and matrix[3, 3] == 1 and matrix[3, :3].any():
        raise ParameterError(
            f"{what}: its translation stands in the last row, as where a matrix is written column by column; write it "
            "row by row, with the last row 0 0 0 1"
        )
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all() or np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-9:
        raise ParameterError(f"{what}: not a 4 x 4 transform of finite numbers with last row 0 0 0 1")
    u, scales, vt = np.linalg.svd(matrix[:3, :3])
    if np.abs(scales - 1.0).max() > 1e-4:
        raise ParameterError(
            f"{what}: the transform scales by {scales.min():.6g} to {scales.max():.6g}; "
            "a rigid transform is needed (state the unit with --unit if the numbers are not metres)"
        )
    if np.linalg.det(matrix[:3, :3]) < 0:
        raise ParameterError(
            f"{what}: the transform mirrors, as where an axis is swapped or points the other way (a left-handed "
            "system); a rigid transform is needed"
        )
    exact = matrix.copy()
    exact[:3, :3] = u @ vt
    return exact
