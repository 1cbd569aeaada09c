"""Range calibration in situ: the cyclic error of a phase-shift rangefinder, from plane patches of the scan itself.

In: a scan (scanner's frame); out: a `Calibration`, and the scan corrected along its beams. Nothegger and Dorninger
2007, section 2.1: harmonic waves of 0.6, 0.3, 0.2 and 0.15 m (Faro LS 880), found together with the planes.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import f as f_distribution

from monitor.declare import check_settings, given_or_default, setting
from monitor.filtering.cyclic_adjustment import (
    SHORTEST,
    Adjustment,
    Patch,
    adjust_waves,
    combine_votes,
    median_deviation,
    prepare_patches,
    refine_length,
    residuals_of,
    search_wavelength,
    true_ranges,
    waves_at,
)
from monitor.filtering.drawing_order import draw_order
from monitor.filtering.nearest import BLOCK
from monitor.filtering.patches import find_plane_patches
from monitor.filtering.soundness import require_finite
from projects.model import Bools, Floats, Ints, Scan

FARTHEST_RANGE = 200.0  # m: no phase-shift scanner reaches farther; wavelengths tried are as many as patches are long
SHOWN = 4000  # points of the figure
N_PHASES = 400  # at which the waves are summed


@dataclass(frozen=True, kw_only=True)
class CalibrationSettings:
    """Range calibration in situ. Lengths in metres."""

    enabled: bool = setting(True, unit="", meaning="whether cyclic range errors are looked for and corrected")
    wavelength: float | None = setting(
        None, unit="m", low=0.05, high=10.0,
        meaning="longest wavelength of the cyclic error; auto: of the scanner's preset, else found from the scan",
    )  # fmt: skip
    n_harmonics: int = setting(
        4, unit="", low=1, high=8, meaning="waves looked for: of that wavelength, its half, its third and so on"
    )
    max_amplitude: float = setting(
        0.005, unit="m", low=1e-5, high=0.1, meaning="farthest that the error may bring a point off its plane"
    )
    max_probability: float = setting(
        0.001, unit="", low=1e-12, high=0.5, meaning="probability by chance (F test) above which nothing is corrected"
    )
    min_patches: int = setting(3, unit="", low=1, high=1000, meaning="plane patches that must vote")
    max_points: int = setting(
        40_000,
        unit="points",
        low=1000,
        high=10_000_000,
        meaning="points of the scan among which patches are looked for",
    )

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class Calibration:
    """The cyclic range error of a scan: sum over k of a_k sin(2 pi r / wavelength_k + phase_k), and what speaks for it.

    Attributes
    ----------
    wavelengths : (k,) m, the longest over 1 to k.
    amplitudes, phases : (k,) m and rad; NaN where nothing could be estimated.
    covariance : (2 k, 2 k) of (amplitudes, phases) [m, rad], with that of the wavelength where it was found.
    n_patches, n_walls : patches that voted, and the planes that they are parts of.
    ranges : (2,) m, nearest and farthest range of the patches.
    mad_before, mad_after : m, median absolute distance to the adjusted planes without and with the waves.
    probability : that waves this large appear by chance (F test; with the search for the wavelength where it is made),
        on all walls but the one that speaks most for them.
    votes_for : share of the patches that the waves found from the other walls bring nearer to a plane.
    is_applied, reason : whether the scan is to be corrected, and why (not).
    profile : (m, 3) m, range, and distance to its plane before and after, of points of the patch of the greatest span.
    """

    wavelengths: Floats
    amplitudes: Floats
    phases: Floats
    covariance: Floats
    n_patches: int
    n_walls: int
    ranges: Floats
    mad_before: float
    mad_after: float
    probability: float
    votes_for: float
    is_applied: bool
    reason: str
    profile: Floats


def calibrate_range(scan: Scan, settings: CalibrationSettings | None = None) -> Calibration:
    """Estimate the cyclic range error of a scan from plane patches found in it.

    Parameters
    ----------
    scan : the whole scan or an even sample of it (`sample_scan`): walls and floor are what is looked for, within
        `FARTHEST_RANGE`. Its `origin` must be known.
    settings : the wavelength is found from the scan where it is not given.

    Returns
    -------
    Calibration
        `is_applied` only where enough patches span the longest wavelength, the waves are significant whichever wall is
        left out, those found on the other walls make most patches flatter, and they bring no point farther off its
        plane than `max_amplitude`.

    Notes
    -----
    A point at measured range r on a plane (n, d) has n'x - d = n'u e(r), u its direction. Coefficients of all waves are
    adjusted together with a plane and a bow (six terms) of every patch; points count by Tukey's biweight, patches by
    the scatter of the means of their cells and by how well they agree with the others, so that a wall that is not
    quite plane has little to say. e is a function of the true range, which is found along with it, as the wavelength is
    where it is not given.

    Raises
    ------
    ParameterError
        If a coordinate is not finite.
    """
    settings = given_or_default(settings, CalibrationSettings)
    require_finite(scan.cloud.points, f"scan {scan.name!r}")
    if not np.isfinite(scan.origin).all():
        return _nothing("it is not known where the scanner stood", settings)
    sampled = sample_scan(scan, settings.max_points).cloud.points - scan.origin
    ranges = np.linalg.norm(sampled, axis=1)
    sampled = sampled[(ranges > 0.0) & (ranges <= FARTHEST_RANGE)]
    found = find_plane_patches(sampled, settings.wavelength or SHORTEST, settings.max_amplitude)
    patches = prepare_patches(found)
    if len(patches) < settings.min_patches:
        return _nothing(_too_few(len(patches), "the longest wavelength", settings), settings)
    given = (settings.wavelength, 1, 0.0) if settings.wavelength else search_wavelength(patches, settings.n_harmonics)
    wavelength, n_tried, step = given
    patches = [p for p in patches if np.ptp(np.quantile(p.ranges, (0.05, 0.95))) >= wavelength]
    return _judge(patches, wavelength / np.arange(1, settings.n_harmonics + 1), (n_tried, step), settings)


def correct_range(scan: Scan, calibration: Calibration) -> Scan:
    """Return the scan with its points moved along their beams by the cyclic error; as it is where none is applied."""
    if not calibration.is_applied:
        return scan
    coefficients = np.concatenate(
        [calibration.amplitudes * np.cos(calibration.phases), calibration.amplitudes * np.sin(calibration.phases)]
    )
    points = np.empty_like(scan.cloud.points)
    for first in range(0, len(points), BLOCK):
        block = slice(first, first + BLOCK)
        beams = scan.cloud.points[block] - scan.origin
        ranges = np.linalg.norm(beams, axis=1)
        true = true_ranges(ranges, coefficients, calibration.wavelengths)
        points[block] = scan.origin + beams * (true / np.maximum(ranges, 1e-12))[:, None]
    return dataclasses.replace(scan, cloud=dataclasses.replace(scan.cloud, points=points))


def sample_scan(scan: Scan, n_points: int) -> Scan:
    """Return at most `n_points` points of a scan, drawn evenly and whatever their order."""
    if len(scan.cloud) <= n_points:
        return scan
    return scan.take(np.sort(draw_order(scan.cloud.points, 0)[:n_points]))


def _too_few(n_patches: int, wavelength: str, settings: CalibrationSettings) -> str:
    """Return in words that fewer plane patches than are needed span a wavelength."""
    spanning = "1 plane patch spans" if n_patches == 1 else f"{n_patches} plane patches span"
    return f"{spanning} {wavelength}; {settings.min_patches} {'is' if settings.min_patches == 1 else 'are'} needed"


def _nothing(reason: str, settings: CalibrationSettings) -> Calibration:
    """Return the calibration of a scan that says nothing of cyclic errors."""
    n, nan = settings.n_harmonics, math.nan
    return Calibration(
        np.full(n, nan), np.full(n, nan), np.full(n, nan), np.full((2 * n, 2 * n), nan), 0, 0, np.full(2, nan),
        nan, nan, nan, nan, False, reason, np.empty((0, 3)),
    )  # fmt: skip


def _judge(
    patches: list[Patch], wavelengths: Floats, search: tuple[int, float], settings: CalibrationSettings
) -> Calibration:
    """Adjust the waves and decide whether they are to be believed.

    `search` is how many longest wavelengths were tried, and their step [1/m]; 0 of one that was given.
    """
    if len(patches) < settings.min_patches:
        return _nothing(_too_few(len(patches), f"the longest wavelength, {wavelengths[0]:.3f} m", settings), settings)
    adjusted, covariance = _adjusted(patches, wavelengths, search[1])
    c, wavelengths, groups = adjusted.coefficients, adjusted.wavelengths, groups_of(patches)
    freedoms = np.array([int(p.cells[1].max()) + 1 - 6 for p in patches])
    probability = min(1.0, search[0] * _chance_without_any(adjusted, groups, freedoms))
    share, farthest = _votes_for(adjusted, groups), _farthest(c, wavelengths)
    before, after = [residuals_of(p, wavelengths, 0.0 * c, np.ones(len(p.ranges))) for p in patches], adjusted.residuals
    amplitudes, phases, jacobian = _amplitudes(c)
    is_applied, reason = _decide(probability, share, farthest, settings)
    ranges = np.concatenate([p.ranges for p in patches])
    widest = int(np.argmax([np.ptp(p.ranges) for p in patches]))
    return Calibration(
        wavelengths=wavelengths, amplitudes=amplitudes, phases=phases, covariance=jacobian @ covariance @ jacobian.T,
        n_patches=len(patches), n_walls=len({p.wall for p in patches}), ranges=np.array([ranges.min(), ranges.max()]),
        mad_before=median_deviation(np.concatenate(before)), mad_after=median_deviation(np.concatenate(after)),
        probability=probability, votes_for=share, is_applied=is_applied, reason=reason,
        profile=_profile(patches[widest].ranges, before[widest], after[widest]),
    )  # fmt: skip


def _adjusted(patches: list[Patch], wavelengths: Floats, step: float) -> tuple[Adjustment, Floats]:
    """Return the adjustment of waves and the covariance of its coefficients; their length is adjusted where it was
    found, in steps [1/m]."""
    if step > 0.0:
        return refine_length(patches, wavelengths, step)
    adjusted = adjust_waves(patches, wavelengths)
    return adjusted, np.linalg.inv(adjusted.normal)


def groups_of(patches: Sequence[Patch]) -> list[Bools]:
    """Return which patches (p,) belong to each wall; each patch for itself where all are of one wall, none of one."""
    if len(patches) == 1:
        return []
    walls = np.array([p.wall for p in patches])
    own = walls if len(np.unique(walls)) > 1 else np.arange(len(walls))
    return [own == number for number in np.unique(own)]


def _chance_without_any(adjusted: Adjustment, groups: Sequence[Bools], freedoms: Ints) -> float:
    """Return the probability that waves this large appear by chance where the wall that says most is left out.

    A wall of stones has relief as long as the waves. That of one wall agrees with some waves, and by itself makes all
    walls together significant.
    """
    chances = []
    for own in groups or [np.zeros(len(freedoms), dtype=np.bool_)]:
        normal, c = combine_votes(adjusted.votes, np.where(own, 0.0, adjusted.shares))
        freedom = max(int(freedoms[~own].sum()) - len(c), 1)
        chances.append(float(f_distribution.sf(c @ normal @ c / len(c), len(c), freedom)))
    return max(chances)


def _votes_for(adjusted: Adjustment, groups: Sequence[Bools]) -> float:
    """Return the share of patches that the waves found from the other walls make flatter."""
    flatter = []
    for own in groups:
        _, c = combine_votes(adjusted.votes, np.where(own, 0.0, adjusted.shares))
        flatter += [c @ v.normal @ c < 2.0 * c @ v.right for v, o in zip(adjusted.votes, own, strict=True) if o]
    return float(np.mean(flatter)) if flatter else 1.0


def _farthest(c: Floats, wavelengths: Floats) -> float:
    """Return the largest error [m] over the longest wavelength."""
    return float(np.abs(waves_at(np.linspace(0.0, wavelengths[0], N_PHASES), wavelengths) @ c).max())


def _decide(probability: float, share: float, farthest: float, settings: CalibrationSettings) -> tuple[bool, str]:
    """Return whether to correct the scan, and why."""
    if probability > settings.max_probability:
        return False, f"no significant waves: they appear by chance with a probability of {probability:.2g}"
    if farthest > settings.max_amplitude:
        return False, (
            f"waves of up to {1e3 * farthest:.1f} mm: more than a range error of "
            f"{1e3 * settings.max_amplitude:g} mm, they are the shape of the walls"
        )
    if share < 2.0 / 3.0:
        return False, f"only {share:.0%} of the patches become flatter by the waves found on the others"
    return True, f"waves appear by chance with a probability of {probability:.2g}; {share:.0%} of the patches agree"


def _amplitudes(c: Floats) -> tuple[Floats, Floats, Floats]:
    """Return amplitudes, phases and their Jacobian with respect to the coefficients of sin and cos."""
    sines, cosines = np.split(c, 2)
    amplitudes = np.maximum(np.hypot(sines, cosines), 1e-300)
    rows = [[np.diag(sines / amplitudes), np.diag(cosines / amplitudes)],
            [np.diag(-cosines / amplitudes**2), np.diag(sines / amplitudes**2)]]  # fmt: skip
    return amplitudes, np.arctan2(cosines, sines), np.block(rows)


def _profile(ranges: Floats, before: Floats, after: Floats) -> Floats:
    """Return what the figure of a patch shows (Nothegger and Dorninger, fig. 1), by range."""
    order = np.argsort(ranges, kind="stable")[:: max(1, len(ranges) // SHOWN)]
    return np.column_stack([ranges, before, after])[order]
