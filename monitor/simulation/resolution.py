"""At which resolution, from how many stations: a campaign planned for each setting of a scanner.

A body, what stands beside it, an instrument and where one may stand go in; a plan for each resolution comes out, and
the one that costs least. The sight and the smallest change of each station are those of `planning`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from monitor.simulation.instruments import Instrument
from monitor.simulation.planning import Visibility, plan_campaign, spread_points, visible_change
from monitor.simulation.scanner import stand_at, window_around
from monitor.simulation.scenes import Body, Scene
from projects.errors import ParameterError
from projects.model import Floats
from projects.triangles import vertex_normals

FRACTIONS = (1, 2, 4, 8, 16)
AS_GOOD = 0.01  # share of the surface that a coarser resolution may show less and still be called as good


@dataclass(frozen=True)
class Task:
    """What is to be seen: a change of `change` [m] over `extent` [m], on `reflectance`, registered to within
    `sigma_registration` [m, one sigma of each station's place]; `share` of what all stations together would show.
    """

    change: float = 0.002
    extent: float = 0.02
    reflectance: float = 0.6
    sigma_registration: float = 0.0003
    share: float = 0.95

    def __post_init__(self) -> None:
        if not (self.change > 0.0 and self.extent > 0.0 and self.sigma_registration >= 0.0):
            raise ParameterError(
                f"change {self.change} m, extent {self.extent} m, registration {self.sigma_registration} m: the first "
                "two must lie above 0, the last not below"
            )
        for name in ("reflectance", "share"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise ParameterError(f"{name} {getattr(self, name):g}: a number above 0, up to 1, is needed")


@dataclass(frozen=True)
class Plan:
    """Where to stand and what is seen then, at one resolution.

    Attributes
    ----------
    fraction : of the instrument's resolution: 4 is every fourth pulse in both directions.
    step : rad, angular step.
    taken : which of the candidates, the most useful first.
    n_pulses : of all of them, each scanning the smallest window that holds the body.
    seen : at each point asked about.
    shown : share of the points where the change shows.
    too_few : share that is in sight of a station, but on whose patches fewer than three pulses of any fall.
    unseen : share that no station has in sight.
    """

    fraction: int
    step: float
    taken: tuple[int, ...]
    n_pulses: int
    seen: Visibility
    shown: float
    too_few: float
    unseen: float


def stand_around_body(
    body: Body, *, distances: Sequence[float], heights: Sequence[float], every: float
) -> tuple[Floats, ...]:
    """Return level poses T_project_scanner (4, 4) around a body, in its frame, facing it.

    Parameters
    ----------
    distances : m, outside of the upright cylinder that holds the body's box.
    heights : m, of the scanner above the body's lowest point.
    every : rad, between neighbouring stations of a ring, rounded to a whole number of them; the first stands in front,
        towards negative y.
    """
    if not (len(distances) and len(heights) and every > 0.0) or min(distances) <= 0.0:
        raise ParameterError(
            f"{len(distances)} distances, {len(heights)} heights, every {every} rad: at least one of each is needed, "
            "distances and angle above 0"
        )
    low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
    middle, radius = 0.5 * (low + high), 0.5 * float(np.hypot(*(high - low)[:2]))
    n = max(1, round(2.0 * np.pi / every))
    turns = -0.5 * np.pi + 2.0 * np.pi * np.arange(n) / n
    places = [
        [middle[0] + (radius + d) * np.cos(t), middle[1] + (radius + d) * np.sin(t), low[2] + h]
        for d in distances for h in heights for t in turns
    ]  # fmt: skip
    return tuple(stand_at(np.array(place), facing=middle) for place in places)


def plan_resolutions(
    body: Body, beside: Sequence[Body], instrument: Instrument, candidates: Sequence[Floats], task: Task, *,
    fractions: Sequence[int] = FRACTIONS, n_points: int = 2000, seed: int = 0,
) -> tuple[Plan, ...]:  # fmt: skip
    """Return a plan for each resolution, the finest first; `plan_campaign` chooses the stations of each.

    Parameters
    ----------
    body : what is monitored, near the origin (rays are float32); beside : what else stands there and hides it.
    candidates : poses (4, 4) where one may stand.
    fractions : of the instrument's finest resolution.
    n_points : of the surface that are asked about, spread evenly; a share is known to 0.5 / sqrt(n_points).
    """
    scene = Scene(body.name, (body, *beside))
    points, normals = spread_points(body, n_points, seed=seed)
    box = np.stack([body.vertices.min(axis=0), body.vertices.max(axis=0)])
    windows = [window_around(box, pose) for pose in candidates]
    solid = np.array([(w.azimuth_max - w.azimuth_min) * (w.elevation_max - w.elevation_min) for w in windows])
    plans = []
    for fraction in sorted(fractions):
        step = fraction * instrument.angular_step
        taken, seen = plan_campaign(
            scene, instrument, candidates, points, normals, change=task.change, share=task.share, step=step,
            extent=task.extent, reflectance=task.reflectance, sigma_registration=task.sigma_registration,
        )  # fmt: skip
        n_pulses = int(solid[taken].sum() / step**2)
        shares = (seen.smallest_change <= task.change, seen.in_sight & (seen.n_stations == 0), ~seen.in_sight)
        plans.append(Plan(fraction, step, tuple(taken), n_pulses, seen, *(float(np.mean(share)) for share in shares)))
    return tuple(plans)


def choose_plan(plans: Sequence[Plan]) -> Plan:
    """Return the plan with the fewest stations, then the fewest pulses, of those that show as much as the best does.

    As much: within `AS_GOOD` of the surface.
    """
    best = max(plan.shown for plan in plans)
    good = [plan for plan in plans if plan.shown >= best - AS_GOOD]
    fewest = min(len(plan.taken) for plan in good)
    return min((plan for plan in good if len(plan.taken) == fewest), key=lambda plan: plan.n_pulses)


def see_vertices(
    body: Body, beside: Sequence[Body], instrument: Instrument, stations: Sequence[Floats], step: float, task: Task
) -> Visibility:
    """Return what stations see of each vertex of a body, with the mean normal of its faces."""
    normals = np.nan_to_num(vertex_normals(body.vertices, body.faces))
    return visible_change(
        Scene(body.name, (body, *beside)), instrument, stations, body.vertices, normals, step=step, extent=task.extent,
        reflectance=task.reflectance, sigma_registration=task.sigma_registration,
    )  # fmt: skip
