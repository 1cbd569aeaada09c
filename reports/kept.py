"""Which comparisons and series a project holds of an object, which of them are lost, and which are out of date.

In: an open project and ids. Out: pairs of epochs (reference, compared), steps, and sentences.
"""

from __future__ import annotations

from collections import Counter

from projects.errors import StoreError
from projects.identifiers import comparison_product, series_product, split_product
from projects.model import Step
from projects.store import Project
from reports.quantities import listed


def require_comparison(project: Project, object_id: str, reference_id: str, compared_id: str) -> Step:
    """Return the step of a comparison that the project holds; raise `StoreError` that says how to make it, or how to
    get it back where its file is lost."""
    product, asked = comparison_product(reference_id), f"{object_id} {reference_id} {compared_id}"
    step = project.latest(object_id, compared_id, product)
    if step is not None:
        return step
    if product in {s.product for s in project.steps(object_id, compared_id)}:
        raise lost_error(_name_result(product, object_id, compared_id), project, asked)
    if project.latest(object_id, reference_id, comparison_product(compared_id)) is not None:
        raise StoreError(
            f"of object {object_id}, {compared_id} is the reference and {reference_id} is compared with it: name "
            f"{compared_id} first; to tell it the other way round, run: monitor compare {project.quoted} {asked}"
        )
    raise StoreError(
        f"{reference_id} and {compared_id} of object {object_id} are not compared yet; run: "
        f"monitor compare {project.quoted} {asked}"
    )


def lost_error(lost: str, project: Project, asked: str) -> StoreError:
    """Return the error that something was made and its file is lost, with what gets it back; `asked` is what
    `monitor compare` is to make anew."""
    return StoreError(
        f"{lost} was made, but its file is missing or cut off; monitor verify {project.quoted} names it: "
        f"restore it from a copy, or make it anew with: monitor compare {project.quoted} {asked}"
    )


def kept_comparisons(project: Project, object_id: str) -> list[tuple[str, str]]:
    """Return every comparison (reference, compared) that the project holds of an object."""
    ids = [e.epoch_id for e in project.epochs(object_id)]
    return [
        (before, after)
        for after in ids
        for before in ids
        if before != after and project.latest(object_id, after, comparison_product(before)) is not None
    ]


def lost_results(project: Project, object_id: str) -> list[str]:
    """Return in words each comparison and series of an object that the index lists and whose file is missing or cut
    off."""
    lost = []
    for epoch in project.epochs(object_id):
        for step in project.steps(object_id, epoch.epoch_id):
            kind, _ = split_product(step.product)
            if kind in ("comparison", "series") and project.latest(object_id, epoch.epoch_id, step.product) is None:
                lost.append(_name_result(step.product, object_id, epoch.epoch_id))
    return lost


def _name_result(product: str, object_id: str, epoch_id: str) -> str:
    """Return in words which comparison or series of an object an epoch keeps as `product`."""
    kind, reference_id = split_product(product)
    return f"the {kind} of {object_id} from {reference_id} to {epoch_id}"


def outdated_epochs(project: Project, object_id: str, pair: tuple[str, str], step: Step) -> list[str]:
    """Return which epochs of a comparison were processed again after its step was made."""
    made_of = {epoch_id: project.latest(object_id, epoch_id, "surface") for epoch_id in pair}
    return [e for e, surface in made_of.items() if surface is not None and surface.step_id not in step.inputs]


def series_resting_on(project: Project, object_id: str, pair: tuple[str, str], step: Step) -> Step | None:
    """Return the series that the compared epoch ends, where there is one that rests on the comparison of `step`, and
    all others that it rests on are the present ones, too, and of one mode."""
    followed = project.latest(object_id, pair[1], series_product(pair[0]))
    if followed is None or step.step_id not in followed.inputs:
        return None
    present = {s.step_id: s for e in project.epochs(object_id) for s in project.steps(object_id, e.epoch_id)}
    rests_on = [present[i] for i in followed.inputs if i in present]
    modes = {s.parameters.get("mode") for s in rests_on if s.product == step.product}  # older versions mixed them
    return followed if len(rests_on) == len(followed.inputs) and len(modes) == 1 else None


def tell_old_series(project: Project, object_id: str, pair: tuple[str, str], step: Step) -> str:
    """Return that the series which the compared epoch ends is left out, "" where it is current or there is none."""
    is_kept = project.latest(object_id, pair[1], series_product(pair[0])) is not None
    if not is_kept or series_resting_on(project, object_id, pair, step) is not None:
        return ""
    return (
        f"epochs of {object_id} were compared anew since change was followed from {pair[0]} to {pair[1]}, so the "
        "series is left out"
    )


def end_of_longest_series(project: Project, object_id: str, reference_id: str) -> str | None:
    """Return the last epoch to which change is followed from a reference by a series that is current."""
    for epoch in reversed(project.epochs(object_id)):
        step = project.latest(object_id, epoch.epoch_id, comparison_product(reference_id))
        if step is not None and series_resting_on(project, object_id, (reference_id, epoch.epoch_id), step) is not None:
            return epoch.epoch_id
    return None


def compared_by_mode(project: Project, object_id: str) -> dict[str, list[str]]:
    """Return which epochs are compared with the first in each mode."""
    first, *later = project.epochs(object_id)
    found: dict[str, list[str]] = {}
    for epoch in later:
        step = project.latest(object_id, epoch.epoch_id, comparison_product(first.epoch_id))
        if step is not None:
            found.setdefault(str(step.parameters.get("mode")), []).append(epoch.epoch_id)
    return found


def say_modes(by_mode: dict[str, list[str]]) -> str:
    """Return in words which epochs are compared in which mode, "" where all are in one."""
    told = " and ".join(f"{listed(epochs)} in {mode} mode" for mode, epochs in by_mode.items())
    return f"compared with the first are {told}" if len(by_mode) > 1 else ""


def tell_no_series(project: Project, object_id: str) -> tuple[str, ...]:
    """Return in words that no change is followed over more than two epochs, where two are of one date, or not all are
    compared in one mode; none else."""
    epochs = project.epochs(object_id)
    modes = say_modes(compared_by_mode(project, object_id)) if epochs else ""
    if modes:
        return (
            f"How changes go on over the {len(epochs)} epochs of this object is not told: {modes}, and only absolute "
            "differences hold a motion of the whole.",
        )
    dates = Counter(e.date for e in epochs)
    alike = [e.epoch_id for e in epochs if dates[e.date] > 1]
    if len(epochs) < 3 or not alike:
        return ()
    return (
        f"How changes go on over the {len(epochs)} epochs of this object is not told: epochs {listed(alike)} are of "
        "one date, which leaves no order.",
    )
