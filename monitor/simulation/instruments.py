"""Instruments that can be simulated: panoramic phase-shift scanners as the papers and public sources describe them.

The laser footprint, the noise and the cyclic error of an instrument go in; nothing here computes. What a figure
rests on is said in the docstring of each preset, and what is only assumed; makers' data sheets were not at hand. Who
has one replaces the figures: `dataclasses.replace(INSTRUMENTS["phase-2020"], noise_floor=0.0002)`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from monitor.declare import check_settings, setting
from projects.errors import ParameterError

_ARCSECOND = np.pi / (180.0 * 3600.0)


@dataclass(frozen=True, kw_only=True)
class Instrument:
    """A panoramic phase-shift scanner. Lengths in metres, angles in radians.

    The range noise of one pulse is `noise_floor**2 + noise_10m**2 * P10 / P`: P is the power received, P10 that from
    a target of 90 % reflectance seen face on at 10 m, so the second term grows with range, incidence and darkness as
    a shot-noise limited receiver's does. Laser wavelengths play no part. The cyclic error is the sum over k of
    `cyclic_amplitudes[k] * sin(2 pi (k + 1) r / cyclic_wavelength + cyclic_phases[k])`. Axis errors as in Lichti and
    Licht 2006 (Experiences with terrestrial laser scanner modelling), from whose 19 terms only the trunnion and
    collimation axis and the cyclic errors are taken: range offset, index error and the empirical terms are left out.

    No source at hand states a trunnion or collimation axis error of any of the presets, and paper 003, section 1.2.2,
    leaves them out as even over a narrow field: they are 0 there, which means unknown, not absent. Who has calibrated
    an instrument puts its own in: `dataclasses.replace(INSTRUMENTS["leica-hds6000"], trunnion_error=5e-5)`.
    """

    name: str = setting("phase scanner", unit="", meaning="name, written into the scans")
    beam_diameter: float = setting(0.003, unit="m", low=0.0, high=0.1, meaning="1/e2 diameter of the beam at its exit")
    beam_divergence: float = setting(0.0002, unit="rad", low=0.0, high=0.05, meaning="full 1/e2 angle of the beam")
    noise_floor: float = setting(0.0003, unit="m", low=0.0, meaning="range noise that no light removes, one sigma")
    noise_10m: float = setting(0.0004, unit="m", low=0.0, meaning="range noise by the light, 90 % face on at 10 m")
    angular_noise: float = setting(5.0 * _ARCSECOND, unit="rad", low=0.0, meaning="noise of each angle, one sigma")
    trunnion_error: float = setting(0.0, unit="rad", meaning="tilt i of the trunnion axis: azimuth off by i tan(el)")
    collimation_error: float = setting(0.0, unit="rad", meaning="line of sight error c: azimuth off by c / cos(el)")
    cyclic_wavelength: float = setting(0.6, unit="m", low=1e-3, meaning="longest wavelength of the cyclic range error")
    cyclic_amplitudes: tuple[float, ...] = setting((0.0,) * 4, unit="m", meaning="amplitudes, wavelength / 1, 2, 3, 4")
    cyclic_phases: tuple[float, ...] = setting((0.0,) * 4, unit="rad", meaning="phases, wavelength / 1, 2, 3, 4")
    unit_length: float = setting(0.6, unit="m", low=1e-3, meaning="half the shortest modulation wavelength")
    angular_step: float = setting(
        2.0 * np.pi / 40000, unit="rad", low=1e-6, high=0.1, meaning="step of the full resolution"
    )
    range_min: float = setting(0.6, unit="m", low=0.0, meaning="shortest range")
    range_max: float = setting(79.0, unit="m", low=0.0, meaning="longest range")
    elevation_min: float = setting(np.radians(-65.0), unit="rad", meaning="lowest elevation that the mirror sees")
    elevation_max: float = setting(np.radians(90.0), unit="rad", meaning="highest elevation that the mirror sees")
    dropout: float = setting(1e-4, unit="", low=0.0, high=1.0, meaning="share of pulses lost at random")
    power_min: float = setting(
        1e-3, unit="", low=0.0, meaning="power, in units of P10, below which nothing is reported"
    )

    smear: float = setting(
        0.0, unit="", low=0.0, high=1.0, meaning="share of an angular step that the beam sweeps while it measures"
    )
    saturation: float = setting(
        3.0, unit="", low=0.0, meaning="brightness, in units of white seen face on, from which the receiver saturates"
    )

    def __post_init__(self) -> None:
        check_settings(self)
        if len(self.cyclic_amplitudes) != len(self.cyclic_phases):
            raise ParameterError(
                f"{len(self.cyclic_amplitudes)} cyclic amplitudes and {len(self.cyclic_phases)} phases; "
                "give one phase for each amplitude"
            )


def faro_ls880() -> Instrument:
    """Return the Faro LS 880HE of papers 000 and 002.

    Sources: 000 section 2.1 and fig. 1: cyclic error of 0.6, 0.3, 0.2, 0.15 m; median absolute deviation of a plane
    patch 1 mm before and 0.4 mm after calibration, hence one sigma of 0.6 mm at a few metres (its range axis) and an
    amplitude of about 1.9 mm for the strongest wave; 002: the whole effect is below 3 mm, here 2.9. 000 section 2.4
    and 002: 0.7 mm between pulses on a stove, less than the footprint: as 40000 steps a turn give at 4.5 m and a beam
    of 3 mm and 0.25 mrad has. No source was found for these three, nor for 0.6 to 76 m, a vertical field of 320
    degrees, the angular noise, the phases, and how the amplitude is shared among the four waves: assumed. Trunnion
    axis: Lichti and Licht (2006) have it among the terms they calibrated of a Faro; their figure was not at hand:
    unknown, 0.
    """
    return Instrument(
        name="Faro LS 880HE", beam_diameter=0.003, beam_divergence=0.25e-3, noise_floor=0.5e-3, noise_10m=0.7e-3,
        angular_noise=10.0 * _ARCSECOND, cyclic_amplitudes=(1.6e-3, 0.8e-3, 0.4e-3, 0.3e-3),
        cyclic_phases=(0.4, 2.1, 4.0, 4.4), range_min=0.6, range_max=76.0, elevation_min=np.radians(-70.0),
        dropout=1e-3,
    )  # fmt: skip


def faro_photon120() -> Instrument:
    """Return the Faro Photon 120 of papers 001 and 002.

    Sources: 001 section 4.1, synthetic data, of "modern panoramic scanners": noise of 0.3 to 0.5 mm within 10 m, hence
    0.4 mm at 10 m on 90 %; 001 section 4.1, sculptures: 2 mm on average at quarter resolution from at most 5 m, as
    40000 steps a turn give from 3.2 m; the name: 120 m. No source was found for the beam, 3.3 mm at exit and 0.16 mrad,
    the residual cyclic error (0.2 mm), that this noise is half floor and half light, the shortest range and the angular
    noise: assumed. Trunnion axis: no source, unknown, 0.
    """
    return Instrument(
        name="Faro Photon 120", beam_diameter=0.0033, beam_divergence=0.16e-3, noise_floor=0.28e-3, noise_10m=0.28e-3,
        angular_noise=6.0 * _ARCSECOND, cyclic_amplitudes=(0.2e-3, 0.1e-3, 0.05e-3, 0.05e-3),
        cyclic_phases=(1.0, 0.3, 3.3, 5.0), range_min=0.6, range_max=120.0, dropout=3e-4,
    )  # fmt: skip


def leica_hds6000() -> Instrument:
    """Return the Leica HDS 6000 of papers 001 and 003.

    Sources: 003 section 4.1: ambiguity range 79 m, shortest distance 1 m, finest step 0.009 degrees; section 1.2.2: a
    spot of 3 mm at 3.5 m and, with the motion of the beam, about 4 mm at 5 m: a beam of 3 mm at exit that widens by
    0.22 mrad is 3.1 mm wide at 3.5 m, and its 3.2 mm at 5 m and the 0.8 mm of one step make 4 mm.
    Section 4.3: one scan of the relief lies 0.7 mm (one sigma) from the reference. Assumed: that 0.6 mm of those
    0.7 mm is range noise, its split, no cyclic error left, angular noise. Sections 1.2.2 and 1.3 also draw on 1 and
    2 mm (maker's figures for any target and range); section 3.1 measured 0.4 mm on one point in 20 repetitions.
    Trunnion axis: section 1.2.2 names it and states no figure: unknown, 0.
    """
    return Instrument(
        name="Leica HDS 6000", beam_diameter=0.003, beam_divergence=0.22e-3, noise_floor=0.55e-3, noise_10m=0.8e-3,
        angular_noise=10.0 * _ARCSECOND, angular_step=float(np.radians(0.009)), range_min=1.0, range_max=79.0,
        smear=1.0, elevation_min=np.radians(-65.0), dropout=5e-4,
    )  # fmt: skip


def current_phase_scanner() -> Instrument:
    """Return a phase scanner as sold around 2020 (Faro Focus S, Z+F Imager 5016 class).

    Source: the maker's data sheet of the Faro Focus M/S as a public catalogue of scanners quotes it (the comments of
    the scanner models of the plant simulator Helios): beam 2.12 mm at exit and 0.3 mrad, both to 1/e of its power;
    vertical field of 300 degrees, so from -60 degrees up. A beam of 1550 nm and 3.0 mm (2.12 mm * sqrt 2, to 1/e2)
    cannot diverge by less than 4 lambda / (pi D) = 0.66 mrad in full, so those 0.3 mrad must be the half angle: 0.85
    mrad in full to 1/e2.
    Angular noise: 2 to 4 arc seconds were measured of a Z+F Imager 5016A (Methodological framework for determining
    vertical angular variances of terrestrial laser scanners, ISPRS Annals XI-1-2026, 363). No source was found for
    the 1550 nm, 0.3 mm noise at 10 m on 90 % and its split, 0.6 to 150 m, and that no cyclic error is left: assumed.
    Trunnion axis: no source, unknown, 0.
    """
    return Instrument(
        name="phase scanner 2020", beam_diameter=0.0030, beam_divergence=0.85e-3, noise_floor=0.15e-3,
        noise_10m=0.26e-3, angular_noise=4.0 * _ARCSECOND, range_min=0.6, range_max=150.0,
        elevation_min=np.radians(-60.0), dropout=1e-4,
    )  # fmt: skip


INSTRUMENTS: Mapping[str, Instrument] = {
    "faro-ls880": faro_ls880(),
    "faro-photon120": faro_photon120(),
    "leica-hds6000": leica_hds6000(),
    "phase-2020": current_phase_scanner(),
}


def without_errors(instrument: Instrument) -> Instrument:
    """Return the instrument with its footprint but without any noise, cyclic or axis error, or dropout."""
    silent = (0.0,) * len(instrument.cyclic_amplitudes)
    return dataclasses.replace(
        instrument, noise_floor=0.0, noise_10m=0.0, angular_noise=0.0, trunnion_error=0.0, collimation_error=0.0,
        cyclic_amplitudes=silent, cyclic_phases=silent, dropout=0.0,
    )  # fmt: skip
