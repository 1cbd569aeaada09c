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
