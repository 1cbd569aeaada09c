"""How a step of the chain is kept: found by the hash of what was asked of which inputs, or made and put.

In come the epoch, what is asked, and a function that makes it; out comes the step in the store.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from projects.errors import MonitorError, StoreError
from projects.model import Step
from projects.products import GIVEN
from projects.provenance import now, step_id, versions
from projects.store import Project

# Raised when a step's method changes, so that what an older version made is made anew.
METHOD = {
    "calibration": 6,
    "scan": 11,
    "averaged": 13,  # repeated scans; until 10 a "scan" like others
    "targets": 2,
    "network": 18,
    "filtered": 11,
    "surface": 32,
    "mesh": 10,
    "quality": 3,
    "comparison": 65,
    "series": 22,
}


@dataclass(frozen=True)
class Place:
    """One epoch of one object of a project: where a product belongs."""

    project: Project
    object_id: str
    epoch_id: str

    def get(self, step: Step) -> Any:
        """Return what a step of this epoch made."""
        return self.project.get(self.object_id, self.epoch_id, step.product, step.step_id)


@dataclass(frozen=True)
class Asked:
    """What is asked: a product, by which kind of step, with which parameters, of which inputs."""

    product: str
    kind: str
    parameters: Mapping[str, Any]
    inputs: tuple[Step, ...]

    @property
    def step_id(self) -> str:
        """The hash that identifies the result."""
        return step_id(self.product, self.parameters, tuple(s.step_id for s in self.inputs), METHOD[self.kind])


@dataclass(frozen=True)
class Made:
    """What a step made, what it found by itself and what it counted."""

    noun: Any
    automatic: Mapping[str, Any] = field(default_factory=dict)
    counts: Mapping[str, Any] = field(default_factory=dict)


def latest_step(place: Place, product: str) -> Step:
    """Return the present step of a product, or say what to do."""
    place.project.epoch(place.object_id, place.epoch_id)
    step = place.project.latest(place.object_id, place.epoch_id, product)
    if step is None and product in GIVEN:
        raise StoreError(
            f"what was added as epoch {place.epoch_id} of object {place.object_id} is missing or was cut off; "
            f"monitor verify {place.project.quoted} names the file: restore it from a copy, or remove the epoch and "
            "add it again from its files"
        )
    if step is None:
        raise StoreError(
            f"epoch {place.epoch_id} of object {place.object_id} has no {product} yet; run: "
            f"monitor process {place.project.quoted} {place.object_id} {place.epoch_id}"
        )
    return step


def find_step(place: Place, asked: Asked) -> Step | None:
    """Return the step if it was made already."""
    return place.project.find(place.object_id, place.epoch_id, asked.product, asked.step_id)


def put_step(place: Place, asked: Asked, made: Made, seconds: float) -> Step:
    """Keep what a step made, with its whole record."""
    step = Step(
        step_id=asked.step_id,
        product=asked.product,
        parameters=asked.parameters,
        inputs=tuple(s.step_id for s in asked.inputs),
        automatic=made.automatic,
        counts=made.counts,
        versions=versions(),
        created=now(),
        seconds=seconds,
    )
    require = partial(_require_inputs, place, asked)
    return place.project.put(place.object_id, place.epoch_id, step, made.noun, require=require)


def _require_inputs(place: Place, asked: Asked) -> None:
    """Raise `StoreError` where what a product was made from was taken out or replaced while it was being made."""
    epochs = place.project.epochs(place.object_id)
    present = {s.step_id for e in epochs for s in place.project.steps(place.object_id, e.epoch_id)}
    gone = [step.product for step in asked.inputs if step.step_id not in present]
    if gone:
        raise StoreError(
            f"object {place.object_id}, epoch {place.epoch_id}: {gone[0]}, of which {asked.product} was made, was "
            "taken out or replaced by another program meanwhile; nothing was entered: run the command again"
        )


def once_step(place: Place, asked: Asked, make: Callable[[], Made]) -> Step:
    """Return the step if it was made already, otherwise make and keep it."""
    found = find_step(place, asked)
    if found is not None:
        return found
    started = time.perf_counter()
    try:
        made = make()
    except MonitorError as error:
        raise type(error)(f"object {place.object_id}, epoch {place.epoch_id}: {error}") from error
    return put_step(place, asked, made, time.perf_counter() - started)
