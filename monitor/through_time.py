"""More than two epochs: change followed on the first epoch's surface, and the object's motion from one network.

In come a project and an object whose epochs are compared; out comes the step "series-FIRST", kept with the last epoch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import groupby, pairwise
from typing import Any

import numpy as np
import pandas as pd
from scipy.linalg import block_diag

from monitor.comparison import EpochChange, follow
from monitor.comparison.between import SAME
from monitor.comparison.series.follow import DAYS_PER_YEAR
from monitor.record import Asked, Made, Place, once_step
from monitor.registration import MotionSignificance, motion_significance
from monitor.registration.motion.held import Frames
from monitor.registration.network.epoch_network import EpochLink, EpochNetwork, adjust_network
from monitor.registration.network.steady_motion import fit_steady_motion
from monitor.scan_network import frames_of
from projects.identifiers import comparison_product, series_product
from projects.model import CLOSURE_COLUMNS, MOTION_COLUMNS, Comparison, EpochRecord, Floats, Registration, Step
from projects.records import plain
from projects.store import Project
from projects.transforms import rows_of_inverse

Notify = Callable[[str], None]


def follow_epochs(project: Project, object_id: str, notify: Notify) -> Step | None:
    """Follow change over all epochs compared with the first (step 13 of the chain) and keep it with the last of them.

    None where fewer than two are, where two of one date leave no order, or where some are compared in absolute and
    some in relative mode.
    """
    first, *later = project.epochs(object_id)
    found = [(e, kept_comparison(project, object_id, first, e)) for e in later]
    epochs = [e for e, step in found if step is not None]
    direct = [step for _, step in found if step is not None]
    if len(epochs) < 2 or epochs_of_one_date(project, object_id) or len({s.parameters.get("mode") for s in direct}) > 1:
        return None
    steps = [kept_comparison(project, object_id, a, b) for a, b in pairwise(epochs)]
    between = [(k, step) for k, step in enumerate(steps) if step is not None]
    before, *places = (Place(project, object_id, e.epoch_id) for e in (first, *epochs))

    def make() -> Made:
        """Follow the regions, and adjust all registrations between the epochs in one network."""
        notify(f"following change over {len(epochs) + 1} epochs")
        comparisons = [p.get(s) for p, s in zip(places, direct, strict=True)]
        changes = [EpochChange(e.epoch_id, e.date, c) for e, c in zip(epochs, comparisons, strict=True)]
        series = follow(changes, first.epoch_id, first.date, level=strictest_level(direct))
        links = [EpochLink(0, k + 1, c.registration) for k, c in enumerate(comparisons)]
        links += [EpochLink(k + 1, k + 2, places[k + 1].get(s).registration) for k, s in between]
        stood = (before, *places)
        own = [without_frames(link, frames_of((stood[link.target], stood[link.source]))) for link in links]
        network = adjust_network(own, len(stood))
        frames = [frames_of((before, place)) for place in places]
        motions, closures = tell_network(network, own, [first, *epochs], frames)
        steady = tell_steady_motion(network, [first, *epochs], [frames_of((place,)) for place in stood])
        figures = {"closure_chi2": network.chi2, "closure_freedom": network.freedom,
                   "closure_probability": network.probability}  # fmt: skip
        by_trend = int((series.regions["found_by"] == "trend").sum())
        counts = {"regions": len(series.regions), "regions_by_trend": by_trend, "epochs": len(epochs) + 1}
        doubts = tell_doubts(comparisons, stood)
        told = {**series.statistics, **steady, **({"doubts": doubts} if doubts else {})}
        return Made(replace(series, motions=motions, closures=closures, statistics=told), figures, counts)

    asked = Asked(series_product(first.epoch_id), "series", {}, (*direct, *(s for _, s in between)))
    return once_step(places[-1], asked, make)


def tell_doubts(comparisons: Sequence[Comparison], places: Sequence[Place]) -> list[dict[str, str]]:
    """Return what speaks against how each epoch lies on the first, or how the scans of one lie on each other, as the
    `statistics` of a series hold it; `places` are of the first epoch and of those that the comparisons are of."""
    networks = [(p, p.project.latest(p.object_id, p.epoch_id, "network")) for p in places]
    told = [(p, "pose", c.registration.doubt) for p, c in zip(places[1:], comparisons, strict=True)]
    told += [(p, "scans", str(step.automatic.get("doubt") or "")) for p, step in networks if step is not None]
    return [{"epoch": p.epoch_id, "of": of, "doubt": doubt} for p, of, doubt in told if doubt]


def epochs_of_one_date(project: Project, object_id: str) -> list[str]:
    """Return the ids of the first epochs of one date among those compared with the first, and it; none where all
    differ."""
    first, *later = project.epochs(object_id)
    known = [first, *(e for e in later if kept_comparison(project, object_id, first, e) is not None)]
    alike = [[e.epoch_id for e in group] for _, group in groupby(known, key=lambda e: e.date)]
    return next((ids for ids in alike if len(ids) > 1), [])


def kept_comparison(project: Project, object_id: str, reference: EpochRecord, compared: EpochRecord) -> Step | None:
    """Return the step of a comparison that the project holds, None where there is none."""
    return project.latest(object_id, compared.epoch_id, comparison_product(reference.epoch_id))


def strictest_level(comparisons: Sequence[Step]) -> float:
    """Return the least false discovery rate that was asked of any of the comparisons."""
    return min(float(step.parameters["compare"]["false_discovery_rate"]) for step in comparisons)


def without_frames(link: EpochLink, frames: Frames | None) -> EpochLink:
    """Return a link as sure as the shapes tell it: what the frames of its epochs may differ by, which its covariance
    holds where it is known, is the same in every link of an epoch, and no adjustment averages it."""
    if frames is None:
        return link
    registration = link.registration
    of_frames = frames.about(registration.centre)
    alone = np.allclose(registration.covariance, of_frames, rtol=SAME, atol=0.0)  # no shape tells anything of it
    own = np.zeros((6, 6)) if alone else registration.covariance - of_frames
    return replace(link, registration=replace(registration, covariance=own))


def tell_network(network: EpochNetwork, links: Sequence[EpochLink], epochs: Sequence[EpochRecord],
                 frames: Sequence[Frames | None]) -> tuple[pd.DataFrame, pd.DataFrame]:  # fmt: skip
    """Return the motion of each epoch against the first, and the misfit of each link, as tables; `frames` say for each
    epoch but the first how far its own and the first one's may differ, which the network does not hold."""
    motions = [_motion_row(network, k, epochs, frames[k - 1]) for k in range(1, len(epochs))]
    closures = [[epochs[link.target].epoch_id, epochs[link.source].epoch_id, float(m)]
                for link, m in zip(links, network.misfit, strict=True)]  # fmt: skip
    return (pd.DataFrame(motions, columns=list(MOTION_COLUMNS)),
            pd.DataFrame(closures, columns=list(CLOSURE_COLUMNS)))  # fmt: skip


def tell_steady_motion(network: EpochNetwork, epochs: Sequence[EpochRecord], frames: Sequence[Frames | None],
                       ) -> dict[str, Any]:  # fmt: skip
    """Return how the object moves on as a whole, as the `statistics` of a series hold it: the member `steady_motion`,
    vectors and matrices as lists, as a record is stored.

    `frames` say of each epoch how far its own may be off. Nothing is told of epochs where that is not known, and
    without the first and two others nothing at all: whatever the frames differ by would pass for a motion. Nor where
    what is left of the links without the frames is no covariance.
    """
    known = [k for k in range(1, len(epochs)) if frames[k] is not None]
    if frames[0] is None or len(known) < 2:
        return {}
    moved = [_motion_of(network, k, 0.0) for k in known]
    rows = np.concatenate([np.arange(6 * k - 6, 6 * k) for k in known])
    of_first = np.kron(np.ones((len(known), len(known))), frames[0].about(network.centre))
    of_each = block_diag(*(of_frame.about(network.centre) for of_frame in frames[1:] if of_frame is not None))
    inverse = block_diag(*(rows_of_inverse(network.T_first_epoch[k]) for k in known))
    covariance = inverse @ (network.joint[np.ix_(rows, rows)] + of_first + of_each) @ inverse.T
    if not np.linalg.eigvalsh(covariance).min() > 0.0:
        return {}
    steady = fit_steady_motion(
        np.array([_years_since(epochs, k) for k in known]), np.array([[*m.rotation, *m.translation] for m in moved]),
        covariance,
    )  # fmt: skip
    return {"steady_motion": plain({"centre": network.centre, "epochs": len(known) + 1, **vars(steady)})}


def _motion_row(network: EpochNetwork, k: int, epochs: Sequence[EpochRecord], frames: Frames | None) -> list[object]:
    """Return the object's motion from the first epoch to epoch k, the inverse of what undoes it; whether it is one is
    known only with the `frames`."""
    of_frames = 0.0 if frames is None else frames.about(network.centre)
    motion = _motion_of(network, k, of_frames)
    unmoved = motion.probability_unmoved if frames is not None else float("nan")
    sigma_shift, sigma_turn = (
        along(motion.translation, motion.covariance[3:, 3:]),
        along(motion.rotation, motion.covariance[:3, :3]),
    )
    return [epochs[k].epoch_id, _years_since(epochs, k), motion.displacement, sigma_shift, motion.angle, sigma_turn,
            unmoved, *motion.translation, *motion.sigma_translation]  # fmt: skip


def _motion_of(network: EpochNetwork, k: int, of_frames: Floats | float) -> MotionSignificance:
    """Return the motion of the object since the first epoch: the inverse of what undoes it."""
    undo = Registration(network.T_first_epoch[k], network.covariance[k] + of_frames, network.centre, True)
    return motion_significance(undo)


def _years_since(epochs: Sequence[EpochRecord], k: int) -> float:
    """Return how long after the first an epoch is."""
    return (epochs[k].date - epochs[0].date).days / DAYS_PER_YEAR


def along(vector: Floats, covariance: Floats) -> float:
    """Return one sigma of the length of a vector; that of the most uncertain axis where it is zero."""
    length = float(np.linalg.norm(vector))
    axis = vector / length if length > 0.0 else np.linalg.eigh(covariance)[1][:, -1]
    return float(np.sqrt(axis @ covariance @ axis))
