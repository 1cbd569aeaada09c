"""How targets and control points fit: one small table, where an epoch has any.

In: what the network step of each epoch recorded. Out: a table of texts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from projects.model import Step
from reports.facts import Table
from reports.quantities import count, millimetres

MOST_POINTS = 12  # control points that are told one by one, the worst first


def control_table(steps: Mapping[str, Sequence[Step]]) -> Table:
    """Return how the targets of each epoch and its control points fit; a table without rows where there are none."""
    networks = [next((s.automatic for s in made if s.product == "network"), {}) for made in steps.values()]
    if not any(n.get("ties") for n in networks):
        return Table("Targets and control points", ("", *steps), ())
    rows = [
        ("Targets observed in the scans", *(_count(n, "n_targets") for n in networks)),
        ("Control points held", *(_count(n, "n_control") for n in networks)),
        ("Targets, residuals in space (root mean square)", *(_length(n, "target_rms_m") for n in networks)),
        ("Control points, residuals in space (root mean square)", *(_length(n, "control_rms_m") for n in networks)),
        ("Place of the epoch in the control’s frame (one sigma)", *(_length(n, "sigma_position_m") for n in networks)),
        ("Left out as blunders", *(_blunders(n) for n in networks)),
    ]
    rows += [(f"Control point {name}", *(_residual(n, name) for n in networks)) for name in _worst_points(networks)]
    note = (
        "Residuals are what is left between each point as given or observed and as adjusted. Where an observation "
        "contradicts the others beyond chance it is left out and named."
    )
    return Table("Targets and control points", ("", *steps), tuple(rows), note)


def _count(network: Mapping[str, Any], name: str) -> str:
    """Return a recorded count, "none" where the network had no targets."""
    return count(int(network[name])) if network.get("ties") else "none"


def _length(network: Mapping[str, Any], name: str) -> str:
    """Return a recorded length in millimetres."""
    value = network.get(name)
    return millimetres(math.nan if value is None else float(value))


def _blunders(network: Mapping[str, Any]) -> str:
    """Return the observations that were left out, by name."""
    return ", ".join(map(str, network.get("blunders") or ())) or "none"


def _points(network: Mapping[str, Any]) -> dict[str, float]:
    """Return the length [m] of each control point's residual, NaN for one that was left out."""
    known = (t for t in network.get("ties") or () if t["scan"] < 0)
    return {str(t["name"]): math.hypot(*(math.nan if r is None else float(r) for r in t["residual_m"])) for t in known}


def _residual(network: Mapping[str, Any], name: str) -> str:
    """Return the residual of a control point in millimetres, or why there is none."""
    points = _points(network)
    if name not in points:
        return "not observed"
    return "left out" if math.isnan(points[name]) else millimetres(points[name])


def _worst_points(networks: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the names of the control points with the largest residuals, those left out first."""
    worst: dict[str, float] = {}
    for network in networks:
        for name, length in _points(network).items():
            worst[name] = max(worst.get(name, 0.0), math.inf if math.isnan(length) else length)
    return sorted(worst, key=lambda name: (-worst[name], name))[:MOST_POINTS]
