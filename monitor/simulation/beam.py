"""The laser beam: its sub-rays, and the range that a phase measurement makes of what they meet.

Scanner positions and directions go in as arrays, rays and measured ranges come out. Mixed pixels at silhouettes
(paper 003, section 1.2.2) are not put in: they follow from the sum of the sub-rays' phases.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from projects.errors import ParameterError
from projects.model import Floats

GLAZE_SLOPE = 0.02  # rms slope of a glossy surface's facets: a highlight about 1 degree wide; assumed

_RADAU_T = (0.0, 3.0 - math.sqrt(3.0), 3.0 + math.sqrt(3.0))


def sample_beam(n_subrays: int) -> tuple[Floats, Floats]:
    """Return where the sub-rays cross the beam, in standard deviations, and their share of its power.

    One centre and two rings of (n - 1) / 2: the Gauss-Radau rule for a Gaussian profile. With
    t = rho**2 / 2 the profile's measure is exp(-t) dt; nodes 0 and 3 -+ sqrt(3) give its moments exactly to t**4.

    Parameters
    ----------
    n_subrays : 1, or 1 + 2k with k >= 3 (9 has two rings of four).

    Returns
    -------
    offsets : (n, 2) in units of the one-sigma radius of the power profile (a quarter of its 1/e2 diameter).
    shares : (n,), their sum is 1.
    """
    if n_subrays == 1:
        return np.zeros((1, 2)), np.ones(1)
    n_ring, odd = divmod(n_subrays - 1, 2)
    if odd or n_ring < 3:
        raise ParameterError(f"n_subrays = {n_subrays}: allowed are 1 and odd numbers from 7 on")
    # Shares from the moments 1, 1, 2 of exp(-t) at the nodes; t = rho^2 / 2.
    shares = np.linalg.solve(np.vander(_RADAU_T, 3, increasing=True).T, [1.0, 1.0, 2.0])
    turn = 2.0 * np.pi * np.arange(n_ring) / n_ring
    offsets, weights = [np.zeros((1, 2))], [shares[:1]]
    for ring in (1, 2):
        angle = turn + (ring - 1) * np.pi / n_ring
        offsets.append(math.sqrt(2.0 * _RADAU_T[ring]) * np.column_stack([np.cos(angle), np.sin(angle)]))
        weights.append(np.full(n_ring, shares[ring] / n_ring))
    return np.concatenate(offsets), np.concatenate(weights)


@njit(cache=True, parallel=True)
def _fill_rays(origin, directions, side, up, offsets, exit_sigma, divergence_sigma, twist, rays):  # type: ignore[no-untyped-def]
    """Write the sub-rays (n, k, 6) of n pulses: origins and directions over a Gaussian beam turned by `twist`."""
    for i in prange(len(directions)):
        c, s = math.cos(twist[i]), math.sin(twist[i])
        for k in range(len(offsets)):
            u = c * offsets[k, 0] - s * offsets[k, 1]
            v = s * offsets[k, 0] + c * offsets[k, 1]
            for j in range(3):
                # Offset (u, v) at the exit and (-v, u) in angle: the radius is that of a Gaussian beam at any range.
                rays[i, k, j] = origin[j] + exit_sigma * (u * side[i, j] + v * up[i, j])
                rays[i, k, 3 + j] = directions[i, j] + divergence_sigma * (u * up[i, j] - v * side[i, j])


def make_rays(
    origin: Floats, directions: Floats, offsets: Floats, *, exit_sigma: float, divergence_sigma: float, twist: Floats
) -> NDArray[np.float32]:
    """Return the sub-rays of each pulse, (n, k, 6) float32: start, then direction (length 1 along the beam's axis).

    The sub-rays are skew lines through the exit; their distance from the axis at range r grows as
    sqrt(exit_sigma**2 + (divergence_sigma * r)**2), as the radius of a Gaussian beam does.

    Parameters
    ----------
    origin : (3,) m; directions : (n, 3) unit; both in the scene's frame.
    offsets : (k, 2) of `sample_beam`.
    exit_sigma : m, a quarter of the beam's 1/e2 diameter; divergence_sigma : rad, a quarter of its full 1/e2 angle.
    twist : (n,) rad, by which the pattern of each pulse is turned, so that no pattern repeats.
    """
    side = np.column_stack([-directions[:, 1], directions[:, 0], np.zeros(len(directions))])
    length = np.linalg.norm(side, axis=1, keepdims=True)
    side = np.where(length > 1e-9, side / np.maximum(length, 1e-9), [1.0, 0.0, 0.0])
    up = np.cross(directions, side)
    rays = np.empty((len(directions), len(offsets), 6), dtype=np.float32)
    _fill_rays(origin, directions, side, up, offsets, exit_sigma, divergence_sigma, twist, rays)
    return rays


@njit(cache=True, parallel=True)
def _sum_phases(t, powers, unit_length, ranges, amplitudes):  # type: ignore[no-untyped-def]
    """Write the range (n,) [m] that the summed phase of the sub-rays shows, and the amplitude of the sum."""
    turn = 2.0 * math.pi / unit_length
    for i in prange(t.shape[0]):
        real, imaginary, total, moment = 0.0, 0.0, 0.0, 0.0
        for k in range(t.shape[1]):
            power, r = powers[i, k], float(t[i, k])
            if power > 0.0:
                real += power * math.cos(turn * r)
                imaginary += power * math.sin(turn * r)
                total += power
                moment += power * r
        if total > 0.0:
            coarse = moment / total
            fine = math.atan2(imaginary, real) / turn
            ranges[i] = fine + unit_length * math.floor((coarse - fine) / unit_length + 0.5)
            amplitudes[i] = math.hypot(real, imaginary)
        else:
            ranges[i], amplitudes[i] = math.nan, 0.0


def measure_phase(t: NDArray[Any], powers: NDArray[Any], unit_length: float) -> tuple[Floats, Floats]:
    """Return the range that a phase-shift rangefinder reports for each pulse, and the amplitude of its signal.

    The rangefinder sees z = sum over sub-rays of power * exp(2 pi i r / unit_length) and reads the phase of z. Whole
    unit lengths are counted by a tone so long that its phase is the mean range weighted by power.

    Parameters
    ----------
    t : (n, k) m, range of each sub-ray.
    powers : (n, k), power that each returns (`return_powers`); 0 where it meets nothing.
    unit_length : m, half the shortest modulation wavelength.

    Returns
    -------
    ranges : (n,) m, NaN where nothing came back.
    amplitudes : (n,), modulus of z; the sum of the powers where all sub-rays have one range.
    """
    ranges, amplitudes = np.empty(len(t)), np.empty(len(t))
    _sum_phases(t, powers, unit_length, ranges, amplitudes)
    return ranges, amplitudes


@njit(cache=True, parallel=True)
def _return_powers(t, rays, normals, reflectance, face, shares, powers):  # type: ignore[no-untyped-def]
    """Write the power (n, k) that returns of each sub-ray: share times reflectance and cosine over range squared."""
    for i in prange(t.shape[0]):
        for k in range(t.shape[1]):
            r = float(t[i, k])
            if not (math.isfinite(r) and r > 0.0):
                powers[i, k] = 0.0
                continue
            cosine = 0.0
            for j in range(3):
                cosine += rays[i, k, 3 + j] * normals[i, k, j]
            powers[i, k] = shares[k] * reflectance[face[i, k]] * abs(cosine) / (r * r)


def return_powers(
    t: NDArray[Any], rays: NDArray[Any], normals: NDArray[Any], face: NDArray[Any], reflectance: Floats, shares: Floats
) -> Floats:
    """Return the power of each sub-ray's return, (n, k): share * reflectance * cos(incidence) / r**2, in 1/m2.

    `t` (n, k) [m] is inf where nothing is met; `rays` (n, k, 6), `normals` (n, k, 3) of the faces met, `face` (n, k)
    their index into `reflectance`, `shares` (k,) of `sample_beam`.
    """
    powers = np.empty(t.shape)
    _return_powers(t, rays, normals, reflectance, face, shares, powers)
    return powers


def add_highlights(powers: Floats, t: NDArray[Any], cosines: Floats, gloss: NDArray[Any], shares: Floats) -> Floats:
    """Return the powers (n, k) with what glossy surfaces throw straight back where they face the scanner.

    The facets of the glaze follow Beckmann's distribution of slopes (Cook and Torrance 1982, eq. 5 to 7) with the rms
    slope m = `GLAZE_SLOPE`; back to the source the return is, in units of a white diffuse surface facing it,
    gloss * exp(-tan(a)**2 / m**2) / (4 m**2 cos(a)**5) at incidence a: 600 times white at m = 0.02, gloss 1.

    Parameters
    ----------
    powers, t, cosines, gloss : (n, k), of `return_powers`, range [m], |cos a|, and the share mirrored.
    shares : (k,), of `sample_beam`.
    """
    c = np.clip(cosines, 1e-6, 1.0)
    tan2 = 1.0 / (c * c) - 1.0
    lobe = np.exp(-tan2 / GLAZE_SLOPE**2) / (4.0 * GLAZE_SLOPE**2 * c**5)
    met = np.isfinite(t) & (t > 0.0)
    thrown = shares * gloss * lobe / np.where(met, t, 1.0) ** 2
    return np.asarray(powers + np.where(met, thrown, 0.0))
