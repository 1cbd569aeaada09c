"""Ties of the network: which targets of several scans are the same, and which of them are control points.

In: the targets of each scan in the project's frame as given, and control points. Out: `Ties`, one observation for each
target in each scan, numbered by the point that it is. Names are not needed: geometry tells (`papers/004`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from monitor.registration.motion.six_parameters import closest_motion, require_spread
from monitor.registration.targets.homologous import match_points
from projects.errors import RegistrationError
from projects.model import Bools, ControlPoint, Floats, Ints, SurveyTarget
from projects.transforms import apply

FARTHEST = 0.1  # m, apart as given, that two scans' views of one target may lie
CLEARLY_MORE = 3  # pairs by invariants than by nearness: a place far from the given one is only then believed
SHARE_OF_SPACING = 0.4  # of the distance to the next target of the same scan
UNSTATED_CONTROL = 0.004  # m, one sigma of a control network by tachymetry (`papers/002`)
LEAST_SIGMA = 0.0005  # m, below which points are not held to be known when they are told apart


@dataclass(frozen=True)
class Ties:
    """Targets as observations of the network.

    Attributes
    ----------
    scan, point : (k,), which scan saw which point.
    positions, covariances : (k, 3) m and (k, 3, 3) m2, in the project's frame as given.
    names : of each point: the control point's, or "target 1" and so on.
    control : (m, 3) m, known position of each point, NaN where it is no control point.
    sigma_control : (m,) m.
    kept, control_kept : (k,) and (m,), False for blunders.
    """

    scan: Ints
    point: Ints
    positions: Floats
    covariances: Floats
    names: tuple[str, ...]
    control: Floats
    sigma_control: Floats
    kept: Bools = field(default_factory=lambda: np.empty(0, dtype=bool))
    control_kept: Bools = field(default_factory=lambda: np.empty(0, dtype=bool))

    def __len__(self) -> int:
        return len(self.scan)

    @property
    def has_control(self) -> Bools:
        """Which points (m,) are held by control."""
        return np.isfinite(self.control[:, 0]) & self.control_kept

    @property
    def holds_the_whole(self) -> bool:
        """Whether control holds every motion: three points that targets are, not on one line within their sigma."""
        held = self.has_control & np.isin(np.arange(len(self.names)), self.point[self.kept])
        try:
            require_spread(self.control[held], self.sigma_control[held])
        except RegistrationError:
            return False
        return True

    def shifted(self, shift: Floats) -> Ties:
        """Return the ties in coordinates less `shift`."""
        return replace(self, positions=self.positions - shift, control=self.control - shift)


def no_ties() -> Ties:
    """Return a network without targets."""
    none = np.empty(0, dtype=int)
    return Ties(none, none, np.empty((0, 3)), np.empty((0, 3, 3)), (), np.empty((0, 3)), np.empty(0))


def identify_targets(targets: Sequence[Sequence[SurveyTarget]], control: Sequence[ControlPoint] = ()) -> Ties:
    """Return which targets are the same point.

    Parameters
    ----------
    targets : of each scan, in the project's frame as given (poses near enough that the same target lies within 0.1 m).
    control : known points in the project's frame.

    Notes
    -----
    Three targets or more of a scan are matched with the control points by invariants, wherever the scan lies as given,
    unless some already lie on control as given and the invariants would carry the scan elsewhere (targets placed alike
    on both sides of an axis); fewer, and those that are no control points, by nearness. A point seen once that is no
    control point ties nothing.
    """
    named = [_name_targets(seen, control) for seen in targets]
    groups: list[_Group] = [_Group(c.name, c.position, c) for c in control]
    for scan, (seen, names) in enumerate(zip(targets, named, strict=True)):
        moved = _onto_control(seen, names, control)
        gate = _gate(moved)
        for target, position, name in zip(seen, moved, names, strict=True):
            group = (
                next((g for g in groups if g.name == name), None) if name else _nearest(groups, position, scan, gate)
            )
            if group is None:
                group = _Group("", position, None)
                groups.append(group)
            group.members.append((scan, target))
    useful = [g for g in groups if len(g.members) + (g.control is not None) >= 2 and g.members]
    return _as_ties(useful)


@dataclass
class _Group:
    """Targets held to be one point; `place` [m] is where it is looked for."""

    name: str
    place: Floats
    control: ControlPoint | None
    members: list[tuple[int, SurveyTarget]] = field(default_factory=list)


def _as_ties(groups: Sequence[_Group]) -> Ties:
    """Return the groups as arrays."""
    if not groups:
        return no_ties()
    members = [(scan, k, target) for k, g in enumerate(groups) for scan, target in g.members]
    known = [g.control for g in groups]
    sigma = [np.nan if c is None else (c.sigma if np.isfinite(c.sigma) else UNSTATED_CONTROL) for c in known]
    return Ties(
        scan=np.array([m[0] for m in members]), point=np.array([m[1] for m in members]),
        positions=np.array([m[2].centre for m in members]),
        covariances=np.array([m[2].covariance for m in members]),
        names=tuple(g.name or f"target {k + 1}" for k, g in enumerate(groups)),
        control=np.array([np.full(3, np.nan) if c is None else c.position for c in known]),
        sigma_control=np.array(sigma, dtype=float),
        kept=np.ones(len(members), dtype=bool), control_kept=np.ones(len(groups), dtype=bool),
    )  # fmt: skip


def sigma_of(targets: Sequence[SurveyTarget]) -> Floats:
    """Return one sigma (n,) [m] of a coordinate of each target, never less than targets are to be told apart by."""
    return np.array([max(float(np.sqrt(np.trace(t.covariance) / 3.0)), LEAST_SIGMA) for t in targets])


def control_arrays(control: Sequence[ControlPoint]) -> tuple[Floats, Floats]:
    """Return positions (m, 3) [m] and sigma (m,) [m] of control points, where unstated that of a usual network."""
    sigma = [c.sigma if np.isfinite(c.sigma) else UNSTATED_CONTROL for c in control]
    return np.array([c.position for c in control]).reshape(-1, 3), np.array(sigma, dtype=float)


def why_none_is_known(targets: Sequence[Sequence[SurveyTarget]], control: Sequence[ControlPoint]) -> str:
    """Return why the scan of most targets holds no control point, in words of the invariants; "" where it has none, or
    they agree."""
    most = max(targets, key=len, default=())
    if not most:
        return ""
    places = np.array([t.centre for t in most])
    try:
        match_points(places, control_arrays(control)[0], sigma_of(most), control_arrays(control)[1])
    except RegistrationError as error:
        return str(error)
    return ""


def _name_targets(seen: Sequence[SurveyTarget], control: Sequence[ControlPoint]) -> list[str]:
    """Return the control point's name of each target, empty where invariants do not tell."""
    names = [t.name for t in seen]
    if min(len(seen), len(control)) < 3:
        return names
    positions, sigma = control_arrays(control)
    try:
        pairs = match_points(np.array([t.centre for t in seen]), positions, sigma_of(seen), sigma)
    except RegistrationError:
        return names
    moved = apply(pairs.T_target_source, np.array([t.centre for t in seen]))
    n_near = _count_near(seen, positions)
    goes_far = any(np.linalg.norm(moved[i] - seen[i].centre) > FARTHEST for i in pairs.source)
    if goes_far and n_near and len(pairs) < n_near + CLEARLY_MORE:
        return names  # targets that lie on control as given: a symmetric arrangement fits elsewhere as well
    for i, j in zip(pairs.source, pairs.target, strict=True):
        names[i] = control[j].name
    return names


def _count_near(seen: Sequence[SurveyTarget], positions: Floats) -> int:
    """Return how many targets of a scan lie, as given, where a control point is."""
    places = np.array([t.centre for t in seen])
    apart = np.linalg.norm(places[:, None] - positions[None], axis=2)
    return int((apart.min(axis=1) <= _gate(places)).sum())


def _onto_control(seen: Sequence[SurveyTarget], names: Sequence[str], control: Sequence[ControlPoint]) -> Floats:
    """Return the targets' places (n, 3) [m], moved onto the control points that three or more of them are."""
    places = np.array([t.centre for t in seen]).reshape(-1, 3)
    known = {c.name: c.position for c in control}
    of_control = [k for k, name in enumerate(names) if name in known]
    if len(of_control) < 3:
        return places
    T = closest_motion(places[of_control], np.array([known[names[k]] for k in of_control]), np.ones(len(of_control)))
    return apply(T, places)


def _gate(places: Floats) -> float:
    """Return how far [m] another scan's view of a target may lie as given."""
    if len(places) < 2:
        return FARTHEST
    apart = np.linalg.norm(places[:, None] - places[None], axis=2) + np.diag(np.full(len(places), np.inf))
    return float(min(FARTHEST, SHARE_OF_SPACING * apart.min()))


def _nearest(groups: Sequence[_Group], position: Floats, scan: int, gate: float) -> _Group | None:
    """Return the nearest point within the gate that the scan has no target of yet."""
    free = [g for g in groups if all(s != scan for s, _ in g.members)]
    best = min(free, key=lambda g: float(np.linalg.norm(g.place - position)), default=None)
    return best if best is not None and np.linalg.norm(best.place - position) <= gate else None
