"""A column scanned twice, with a dent in front and a patch on its right side: a comparison of known figures."""

import datetime
from dataclasses import replace

import numpy as np
import pandas as pd

from projects.model import (
    REGION_COLUMNS,
    Assessment,
    ComparedSurface,
    Comparison,
    ControlPoint,
    EpochRecord,
    NotAssessed,
    ObjectRecord,
    Registration,
    Step,
    Surface,
)
from reports.captions import write_captions
from reports.document import make_facts
from reports.history import EpochHistory

RADIUS, HEIGHT = 0.2, 1.0  # m
DENT = (1, "lost", 0.00785, 0.0002, -3.1e-5, 0.8e-6, -0.0124, 0.00015, -0.0041, 0.00012, 0.0, -0.2, 0.7)
PATCH = (2, "added", 0.0031, 0.0001, 4.2e-6, 0.3e-6, 0.0031, 0.0002, 0.00135, 0.0001, 0.2, 0.0, 0.3)
LOD95 = 0.00035


def column(n_around=90, n_up=75):
    """Return angles and heights of the vertices (n,), and the faces of a column without top and bottom."""
    angle, up = np.meshgrid(2 * np.pi * np.arange(n_around) / n_around, np.linspace(0, HEIGHT, n_up), indexing="ij")
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n_around), np.arange(n_up - 1), indexing="ij"))
    a, b = i * n_up + j, (i + 1) % n_around * n_up + j
    faces = np.concatenate([np.stack([a, b, b + 1], axis=1), np.stack([a, b + 1, a + 1], axis=1)])
    return angle.ravel(), up.ravel(), faces


def bell(angle, up, at, width):
    """Return a cosine bell on the column, 1 at the place `at` (angle, height), 0 beyond `width` [m]."""
    around = RADIUS * ((angle - at[0] + np.pi) % (2 * np.pi) - np.pi)
    far = np.minimum(np.hypot(around, up - at[1]) / width, 1.0)
    return 0.5 + 0.5 * np.cos(np.pi * far)


def example_comparison(rows=(DENT, PATCH), mode="relative", **statistics):
    """Return the comparison of the column; without `rows` nothing changed. The lowest 5 cm are not assessable."""
    angle, up, faces = column()
    dent, patch = bell(angle, up, (-np.pi / 2, 0.7), 0.08), bell(angle, up, (0.0, 0.3), 0.06)
    change = (-0.0124 * dent + 0.0031 * patch) * (len(rows) > 0)
    region = np.where(change < -LOD95, 1, np.where(change > LOD95, 2, 0)).astype(np.int32)
    reasons = np.where(up < 0.02, NotAssessed.FREE_EDGE, np.where(up < 0.05, NotAssessed.NO_FACE, 0)).astype(np.uint8)
    state = np.where(reasons > 0, Assessment.NOT_ASSESSABLE, np.where(region > 0, 2, 1)).astype(np.uint8)
    noise = np.random.default_rng(7).normal(scale=LOD95 / 3, size=len(change))
    sides = []
    for radius in (RADIUS + change, np.full(len(change), RADIUS)):
        surface = Surface(np.stack([radius * np.cos(angle), radius * np.sin(angle), up], axis=1), faces)
        unknown = state == Assessment.NOT_ASSESSABLE
        sides.append(ComparedSurface(surface, np.where(unknown, np.nan, change + noise),
                                     np.where(unknown, np.nan, LOD95), state, region, reasons))  # fmt: skip
    figures = {
        "stable_share": 0.97, "bias_m": 1.2e-5, "nmad_m": 0.00011, "rmse_m": 0.00012, "lod95_median_m": LOD95,
        "share_above_lod95": 0.057, "motion_significance": 0.9999, "motion_is_significant": True,
        "assessed_area_share": 0.953, "changed_area_m2": sum(row[2] for row in rows), "n_vertices": len(state),
        "correlation_length_m": 0.012,
    }  # fmt: skip
    table = pd.DataFrame([list(row) for row in rows], columns=list(REGION_COLUMNS))
    return Comparison(sides[0], sides[1], table, example_registration(), mode, {**figures, **statistics})


def example_registration(shift=0.0032):
    """Return a registration that undoes a shift along x [m], known to 0.05 mm (one sigma) along each axis."""
    undo = np.eye(4)
    undo[0, 3] = -shift
    covariance = np.diag([1e-5] * 3 + [5e-5] * 3) ** 2
    return Registration(undo, covariance, np.array([0.0, 0.0, 0.5]), True, n_inliers=31000, n_correspondences=36000,
                        sigma=0.00013, overlap=0.94, stable_share=0.97)  # fmt: skip


def example_object(**texts):
    """Return the record of the column."""
    given = {"name": "Säule am Tor", "inventory": "K 12/3", "place": "Garden", "material": "limestone"}
    return ObjectRecord("column", **{**given, **texts})


def example_epochs(**texts):
    """Return both epochs with the steps that the chain would have left."""
    first = EpochRecord("column", "e1", datetime.date(2025, 5, 12), "before the winter", scanner="phase-2020",
                        operator="A. Müller", sources=(_source("a.e57", 0), _source("a.e57", 1)))  # fmt: skip
    second = replace(first, epoch_id="e2", date=datetime.date(2026, 5, 18), label="after the restoration",
                     sources=(_source("b.e57", 0), _source("b.e57", 1)), **texts)  # fmt: skip
    compared = Step("c" * 16, "comparison-e1", {"mode": "relative", "compare": {"false_discovery_rate": 0.05}},
                    ("s" * 16,), versions={"heritage-monitor": "0.1.0", "numpy": "2.4.6"},
                    created="2026-05-19T08:00:00+00:00")  # fmt: skip
    return EpochHistory(first, _steps(500)), EpochHistory(second, (*_steps(700), compared))


def controlled_epochs():
    """Return both epochs, each held by a control point."""
    control = (ControlPoint("A", np.zeros(3)),)
    return [replace(epoch, record=replace(epoch.record, control=control)) for epoch in example_epochs()]


def _source(file, index):
    return {"file": file, "sha256": f"{index:064x}", "index": index, "scan": f"{file}#{index}", "n_points": 1234567}


def _steps(n_outliers):
    counts = {"read": 90000, "outside_extent": 1000, "in": 89000, "outlier": n_outliers, "merged": 20000, "out": 68000}
    found = {"noise_before": 0.0012, "noise_after": float("nan"), "spacing_quartiles": [0.0006, 0.0007, 0.0008]}
    fit = {"bias_m": 1e-6, "nmad_m": 0.00021, "rmse_m": 0.00025, "p95_m": 0.0005, "unknown_share": 0.002}
    return (
        Step("r" * 16, "raw", counts={"n_points": 180000, "dropped": {"no return": 4321}}),
        *(Step("f" * 16, f"scan{k:03d}", {"filter": {"h_share": 0.55, "n": None}, "scan": k}, counts=counts,
               automatic=found) for k in range(2)),
        Step("n" * 16, "network", automatic={"misfit_before_m": 0.0004, "misfit_after_m": 0.0002,
                                             "pairs": [{"first": 0, "second": 1, "n": 900}]}),
        Step("m" * 16, "filtered", counts={"in": 136000, "outlier": 12, "merged": 9000, "out": 126988}),
        Step("s" * 16, "surface", automatic={"scan_disagreement_m": 0.00009}, counts={"vertices": 6750, "faces": 9}),
        Step("q" * 16, "quality", automatic={"scan000": fit, "all": fit}),
    )  # fmt: skip


def facts_of(comparison=None, record=None, epochs=None, **texts):
    """Return the facts of the example, or of a changed one; `texts` are of its object."""
    comparison = example_comparison() if comparison is None else comparison
    return make_facts(comparison, record or example_object(**texts), *(epochs or example_epochs()))


def plain(text):
    """Return a text with ordinary spaces."""
    return text.replace("\u00a0", " ").replace("\u202f", " ")


def said(facts):
    """Return the answer as one text."""
    answer = facts.answer
    largest = (f"{told.subject} {told.text}" for told in answer.largest)
    return plain(" ".join((answer.headline, *answer.changed, *largest, *(told.text for told in answer.sure))))


def said_below(facts):
    """Return what stands below the pictures of change."""
    return plain(write_captions(facts).difference)


def rows_of(facts, title):
    """Return the rows of the table of a title, by their first column."""
    table = next(t for t in (*facts.certainty, *facts.history) if t.title == title)
    return {row[0]: [plain(cell) for cell in row[1:]] for row in table.rows}
