"""The second opinion beside a comparison: what M3C2 says of the points of both epochs, without surfaces.

In: the comparison's record. Out: a table of texts, none where M3C2 was not asked (finished meshes have no points).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from projects.model import Step
from reports.facts import Table
from reports.quantities import NAN, count, millimetres, percent


def opinion_tables(made: Step | None) -> tuple[Table, ...]:
    """Return the table of the second opinion that the record `made` of a comparison holds."""
    found: Mapping[str, Any] = {} if made is None else made.automatic.get("m3c2") or {}
    if not found.get("n_core_points"):
        return ()

    def share(name: str) -> str:
        """Return a recorded share in per cent."""
        return percent(float(found.get(name, NAN)))

    def length(name: str) -> str:
        """Return a recorded length in millimetres."""
        return millimetres(float(found.get(name, NAN)))

    rows = (
        ("places asked", count(int(found["n_core_points"]))),
        ("of these, with points of both epochs", share("known_share")),
        ("radius of the cylinders", length("cylinder_radius_m")),
        ("registration error added", length("registration_error_m")),
        ("level of detection (95\u00a0%), median", length("lod95_median_m")),
        ("significant by M3C2, where this comparison says changed", share("share_significant_of_changed")),
        ("significant by M3C2, where it says unchanged", share("share_significant_of_unchanged")),
        (
            "what M3C2 measures less what this does, median",
            millimetres(float(found.get("difference_median_m", NAN)), signed=True),
        ),
        ("how that scatters (robust sigma, NMAD)", length("difference_scatter_m")),
    )
    note = (
        "M3C2 (Lague, Brodu and Leroux 2013) compares the means of the points of both epochs in cylinders along the "
        "surface’s normals. It adds the registration error to every place and judges each by itself, so that about "
        "5\u00a0% of unchanged places may be significant by chance, and faint changes over an area are missed."
    )
    return (Table("A second opinion: M3C2", ("", ""), rows, note),)
