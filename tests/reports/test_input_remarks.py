"""What the reader must know of the files that an epoch came as: scanners' places unknown, meshes turned round."""

import dataclasses

import pytest
from report_examples import example_comparison, example_epochs, example_object

from reports.document import make_facts


def remarks_of(change):
    """Return the remarks of the example, each step of its second epoch changed."""
    before, after = example_epochs()
    after = dataclasses.replace(after, steps=tuple(change(s) for s in after.steps))
    return make_facts(example_comparison(), example_object(), before, after).remarks


@pytest.mark.parametrize(("n_blind", "which"), [(1, "of 1 of 2 scans nobody"), (2, "nobody")])
def test_scans_of_which_nobody_says_where_the_scanner_stood_are_remarked(n_blind, which):
    blind = {f"scan{k:03d}" for k in range(n_blind)}

    def change(step):
        left_out = {"silhouettes_left_out": "it is not known where the scanner stood"}
        return dataclasses.replace(step, automatic={**step.automatic, **left_out}) if step.product in blind else step

    (remark,) = remarks_of(change)
    assert remark == (
        f"Epoch e2: {which} says where the scanner stood: it is not known whether what is missing is gone or was not "
        "seen."
    )


@pytest.mark.parametrize(
    ("n", "inward", "words"),
    [
        (100, False, "the mesh was inside out; its faces were turned outward"),
        (7, False, "7 of 100 faces looked against those around them; they were turned"),
        (0, True, "the mesh looks inward, as a room does that was scanned from within; if it is none, the file is"),
    ],
)
def test_faces_of_a_finished_mesh_that_were_turned_are_remarked(n, inward, words):
    def change(step):
        if step.product != "surface":
            return step
        return dataclasses.replace(step, counts={"faces": 100, "faces_turned": n}, automatic={"looks_inward": inward})

    (remark,) = remarks_of(change)
    assert remark.startswith(f"Epoch e2: {words}")


@pytest.mark.parametrize(
    ("n_points", "told"),
    [
        (2469, "Epoch e2: a piece of 4.41 m by 10 cm about the point 1.23, -0.50, 2.00 m (2 469 points) has no "
               "surface, and no change of it can be told: perhaps its points lie too far apart for its cells, or two "
               "sheets too near each other."),
        (200, ""),
    ],
)  # fmt: skip
def test_a_piece_without_a_surface_is_told_with_size_and_place_and_a_line_is_not(n_points, told):
    found = {"uncovered_share": 0.06, "cell_size_m": 0.02, "spacing_m": 0.01, "bare_piece_points": n_points,
             "bare_piece_size_m": [4.409, 0.101], "bare_piece_place_m": [1.234, -0.5, 2.0]}  # fmt: skip

    def change(step):
        return dataclasses.replace(step, automatic=found) if step.product == "surface" else step

    remarks = [r.replace("\u00a0", " ").replace("\u202f", " ").replace("\u2212", "-") for r in remarks_of(change)]
    assert remarks == ([told] if told else [])
