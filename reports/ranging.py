"""What a report says of the range calibration of its scans: a sentence, and the distances to a plane before and after.

In: a project's calibration steps (`monitor` makes them); out: facts, and a drawing as Nothegger and Dorninger's.
"""

from __future__ import annotations

import numpy as np

from projects.model import Floats, Step
from projects.store import Project
from reports.drawing import INK, SOFT, drawing, plain_number, say_mm, write_svg
from reports.facts import CalibrationFacts
from reports.history import EpochHistory, kind_of
from reports.quantities import MM

SHOWN = 1500  # points of a diagram


def gather_calibrations(project: Project, object_id: str, epoch: EpochHistory) -> tuple[CalibrationFacts, ...]:
    """Return the calibration of the first scan of an epoch that was corrected; empty where none was."""
    steps = [s for s in epoch.steps if kind_of(s) == "calibration" and s.automatic.get("is_applied")]
    if not steps:
        return ()
    epoch_id = epoch.record.epoch_id
    arrays = project.get(object_id, epoch_id, steps[0].product, steps[0].step_id)
    return (CalibrationFacts(_say(epoch_id, steps), np.asarray(arrays["profile"], dtype=float)),)


def _say(epoch_id: str, steps: list[Step]) -> str:
    """Return what was found of the first scan, and how many others were corrected."""
    found = steps[0].automatic
    waves = ", ".join(say_mm(float(a)) for a in found["amplitudes"])
    n = len(steps) - 1
    more = f" {n} other scan{'s were' if n > 1 else ' was'} corrected likewise." if n else ""
    return (
        f"Epoch {epoch_id}, {steps[0].parameters['name']}: cyclic range error found on {found['n_patches']} plane "
        f"patches, amplitudes {waves}; the median deviation from a plane is {say_mm(float(found['mad_before']))} "
        f"before and {say_mm(float(found['mad_after']))} after correction.{more}"
    )


def draw_calibration(profile: Floats) -> bytes:
    """Return the distances of points (m, 3) [range, before, after; m] of a patch to its plane by range, as SVG."""
    some = profile[:: max(1, len(profile) // SHOWN)]
    reach = 1.1 * float(np.quantile(np.abs(profile[:, 1:]), 0.995)) * MM
    with drawing(2.6) as figure:
        for k, name in enumerate(("before", "after")):
            axes = figure.add_axes((0.095, 0.58 - 0.43 * k, 0.875, 0.36))
            axes.plot(some[:, 0], some[:, 1 + k] * MM, ".", ms=1.6, mew=0, color=INK, rasterized=True)
            axes.axhline(0.0, color=SOFT, lw=0.6)
            axes.set_ylim(-reach, reach)
            axes.yaxis.set_major_formatter(plain_number)
            axes.annotate(name, (1, 1), (-3, -3), "axes fraction", textcoords="offset points", ha="right", va="top")
            axes.tick_params(labelbottom=k == 1)
            for edge in ("top", "right"):
                axes.spines[edge].set_visible(False)
        axes.set_xlabel("range [m]")
        figure.text(0.012, 0.55, "distance to the plane [mm]", rotation=90, va="center")
        return write_svg(figure)
