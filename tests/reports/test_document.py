"""What the report says of comparisons whose figures are known."""

import dataclasses
import datetime

import numpy as np
import pytest
from report_examples import (
    DENT,
    PATCH,
    controlled_epochs,
    example_comparison,
    example_epochs,
    example_object,
    facts_of,
    plain,
    rows_of,
    said,
)
from shown_examples import share

from projects.errors import StoreError
from projects.model import Step
from projects.store import Project
from reports import pictures
from reports.answer import WHY_NOT
from reports.captions import write_captions
from reports.certainty import registration_table
from reports.colours import SET_ASIDE
from reports.document import gather_facts
from reports.history import flatten, print_value

NAN = float("nan")
TRACE = "From the scanner to the surface"


def strings_in(value):
    """Return every text of a tree of facts."""
    if isinstance(value, str):
        return [value]
    if isinstance(value, tuple):
        return [s for v in value for s in strings_in(v)]
    if dataclasses.is_dataclass(value):
        fields = [f.name for f in dataclasses.fields(value) if f.name != "comparison"]
        return [s for name in fields for s in strings_in(getattr(value, name))]
    return []


def replace_counts(step, **counts):
    """Return a step that counts more."""
    return dataclasses.replace(step, counts={**step.counts, **counts})


def test_epochs_of_one_survey_are_said_to_show_no_change():
    epochs = example_epochs()
    raw = Step("r" * 16, "raw", inputs=(f"{1:064x}",))
    epochs = tuple(dataclasses.replace(e, steps=(raw, *e.steps[1:])) for e in epochs)
    (remark,) = facts_of(epochs=epochs).remarks
    assert remark.startswith(
        "Both epochs hold the same measurements (b.e57). What was measured once can show no change"
    )


def test_epochs_given_the_wrong_way_round_are_said_to_be():
    before, after = example_epochs()
    comparison = dataclasses.replace(after.steps[-1], product="comparison-e2")
    earlier = dataclasses.replace(before, steps=(*before.steps, comparison))
    (remark,) = facts_of(epochs=(after, earlier)).remarks
    assert plain(remark).startswith("Told backwards in time: epoch e2 of 18 May 2026, the reference, is the later one.")


@pytest.mark.parametrize(
    ("days", "orders"), [((1, 2), ("earlier", "later")), ((2, 1), ("later", "earlier")), ((1, 1), ("first", "second"))]
)
def test_epochs_are_called_earlier_and_later_by_their_dates(days, orders):
    """Captions called the compared epoch the later one, whatever its date."""
    epochs = controlled_epochs()
    dated = [
        dataclasses.replace(e, record=dataclasses.replace(e.record, date=datetime.date(2026, 5, day)))
        for e, day in zip(epochs, days, strict=True)
    ]
    facts = facts_of(epochs=dated)
    assert (facts.before.order, facts.after.order) == orders
    told = {t.title: t for t in facts.certainty}
    note = told["The motion, axis by axis"].note
    assert note.startswith(f"From the {orders[0]} to the {orders[1]} epoch, about the point")
    assert told["What could be assessed"].columns[1:] == (f"{orders[0]} surface", f"{orders[1]} surface")
    figure = facts.answer.figures[3]  # the side of which more could not be assessed
    assert plain(figure.value) == "5.3 %"
    assert plain(figure.note) == f"of the {orders[0]} epoch’s surface; 4.7 % of the other’s"


def test_an_epoch_dated_after_its_comparison_is_pointed_out():
    before, after = example_epochs()
    dated = dataclasses.replace(after.record, date=datetime.date(2062, 5, 18))
    (remark,) = facts_of(epochs=(before, dataclasses.replace(after, record=dated))).remarks
    assert plain(remark).startswith("Epoch e2 is dated 18 May 2062, after this comparison was computed: ")


def test_a_layer_beside_the_motion_has_a_row_of_its_own():
    comparison = example_comparison()
    layered = dataclasses.replace(comparison.registration, layer=-0.001, sigma_layer=0.0001)
    (said,) = [
        value for name, value in registration_table(dataclasses.replace(comparison, registration=layered)).rows
        if "whole surface lies further out" in name
    ]  # fmt: skip
    assert plain(said) == "−1.00 ± 0.20 mm"
    assert not any("further out" in name for name, _ in registration_table(comparison).rows)


def test_doubts_stand_with_the_answer():
    comparison = example_comparison()
    doubted = dataclasses.replace(comparison.registration, doubt="a step further fits as well")
    facts = facts_of(dataclasses.replace(comparison, registration=doubted))
    expected = "In doubt is how the epochs lie on each other: a step further fits as well. See “How sure”."
    assert facts.remarks == (expected,)
    before, after = example_epochs()
    network = dataclasses.replace(before.step("network"), automatic={"doubt": "scan 2 fits elsewhere"})
    steps = tuple(network if s.product == "network" else s for s in before.steps)
    (remark,) = facts_of(epochs=(dataclasses.replace(before, steps=steps), after)).remarks
    assert remark.startswith("In doubt is how the scans of epoch e1 lie on each other: scan 2 fits elsewhere.")


def test_the_second_opinion_is_told_in_words_where_one_was_asked():
    before, after = example_epochs()
    found = {"n_core_points": 4870, "known_share": 0.981, "cylinder_radius_m": 0.0061, "registration_error_m": 1.2e-4,
             "lod95_median_m": 4.1e-4, "share_significant_of_changed": 0.94, "share_significant_of_unchanged": 0.021,
             "difference_median_m": 4e-5, "difference_scatter_m": NAN}  # fmt: skip
    asked = dataclasses.replace(after.steps[-1], automatic={"m3c2": found})
    after = dataclasses.replace(after, steps=(*after.steps[:-1], asked))
    table = facts_of(epochs=(before, after)).certainty[-1]
    assert table.title == "A second opinion: M3C2"
    told = {row[0]: plain(row[1]) for row in table.rows}
    assert told["places asked"] == "4 870"
    assert told["of these, with points of both epochs"] == "98.1 %"
    assert told["radius of the cylinders"] == "6.1 mm"
    assert told["registration error added"] == "0.12 mm"
    assert told["significant by M3C2, where this comparison says changed"] == "94.0 %"
    assert told["significant by M3C2, where it says unchanged"] == "2.1 %"
    assert told["what M3C2 measures less what this does, median"] == "+0.040 mm"
    assert told["how that scatters (robust sigma, NMAD)"] == "not known"
    assert not any("second opinion" in t.title for t in facts_of().certainty)


def test_the_motion_of_the_whole_is_the_inverse_of_the_registration():
    facts = facts_of(epochs=controlled_epochs())
    text = said(facts)
    assert "stands 3.20 ± 0.10 mm from where it stood" in text
    assert "this is taken out of the differences." in text
    assert rows_of(facts, "The motion, axis by axis")["x"][0] == "+3.20 ± 0.10"


def test_control_points_that_no_scan_saw_hold_nothing_and_are_told_so():
    before, after = controlled_epochs()
    network = dataclasses.replace(before.step("network"), automatic={"n_control": 0})
    before = dataclasses.replace(before, steps=tuple(network if s.product == "network" else s for s in before.steps))
    facts = facts_of(epochs=(before, after))
    assert facts.remarks == ("The control points of epoch e1 hold nothing: none of them was found in its scans.",)
    assert "agree is not known without control points that hold both" in said(facts)


def test_control_points_about_which_the_whole_may_turn_are_told_so():
    before, after = controlled_epochs()
    network = dataclasses.replace(before.step("network"), automatic={"n_control": 1, "sigma_position_m": NAN})
    before = dataclasses.replace(before, steps=tuple(network if s.product == "network" else s for s in before.steps))
    facts = facts_of(epochs=(before, after))
    assert facts.remarks == (
        "The control points of epoch e1 do not hold it as a whole: 1 of 1 holds a target of its scans, and it may "
        "still turn about them. That takes three that are not on one line.",
    )
    assert "agree is not known without control points that hold both" in said(facts)


def test_unknown_figures_are_said_to_be_not_known():
    broken = [(*DENT[:5], NAN, NAN, NAN, *DENT[8:]), PATCH]
    figures = dict.fromkeys(("lod95_median_m", "bias_m", "nmad_m", "share_above_lod95", "motion_significance"), NAN)
    facts = facts_of(example_comparison(rows=broken, **figures))
    assert facts.regions[0].extreme.text == "not known"
    assert plain(facts.regions[0].volume.text) == "−31 cm³ (margin not known)"
    assert "is not known (95 %" in said(facts)
    assert rows_of(facts, "What can be seen")["scatter there (robust sigma, NMAD)"] == ["not known"]
    words = {word for text in strings_in(facts) for word in text.replace("\u00a0", " ").split()}
    assert not words & {"nan", "NaN", "None", "inf"}


NO_FACE = "Not assessable: the other epoch has no surface there that faces the same way"
FREE_EDGE = "Not assessable: it lies beyond the edge of what the other epoch recorded"


def test_what_could_not_be_assessed_is_told_by_its_reason_of_both_surfaces():
    rows = rows_of(facts_of(), "What could be assessed")
    assert rows[NO_FACE] == rows[FREE_EDGE] == ["2.7 %", "2.7 %"]  # 180 of 6750 vertices
    assert list(rows)[:2] == ["Assessed, unchanged", "Assessed, changed"]
    assert len(rows) == 4


def test_what_could_not_be_assessed_is_of_the_area_where_that_is_known():
    """An edge beyond the points, of many vertices, is no area: it is not the reason why the surface is not assessed."""
    nothing = {reason.name.lower(): 0.0 for reason in WHY_NOT}
    areas = [{**nothing, "unchanged": 0.75, "changed": 0.05, "no_face": 0.2},
             {**nothing, "unchanged": 0.9, "changed": 0.0, "no_face": 0.1}]  # fmt: skip
    facts = facts_of(example_comparison(areas_by_assessment_m2=areas, assessed_area_share_reference=0.8))
    assert rows_of(facts, "What could be assessed") == {
        "Assessed, unchanged": ["75 %", "90 %"], "Assessed, changed": ["5.0 %", "0 %"], NO_FACE: ["20 %", "10 %"],
    }  # fmt: skip
    assert "20 % of the earlier epoch’s surface could not be assessed, mostly because the other epoch has no" in said(
        facts
    )


def test_the_points_of_all_scans_are_summed_by_reason():
    rows = rows_of(facts_of(), TRACE)
    assert rows["dropped on reading: no return"] == ["4 321", "4 321"]
    assert rows["outliers of one scan alone"] == ["1 000", "1 400"]
    assert rows["left after filtering each scan"] == ["136 000", "136 000"]
    assert rows["left after merging"] == ["126 988", "126 988"]


def test_what_was_no_measurement_is_counted_once_and_above_what_was_measured():
    """It stood among what the filter dropped, too, though it was never among the points read."""
    before, after = example_epochs()
    scans = [replace_counts(s, not_measured_no_return=4321) if s.product == "scan000" else s for s in before.steps]
    rows = rows_of(facts_of(epochs=(dataclasses.replace(before, steps=tuple(scans)), after)), TRACE)
    assert list(rows)[:2] == ["dropped on reading: no return", "measured points in the files"]
    assert not [name for name in rows if name.startswith("not measured")]


def test_every_reason_that_a_step_counts_stands_in_the_table_and_none_speaks_of_scans_that_are_not():
    before, after = example_epochs()
    more = {"copy": 3, "rejected": 8, "of_a_new_kind": 5}
    steps = [replace_counts(s, **more) if s.product == "filtered" else s for s in before.steps]
    rows = rows_of(facts_of(epochs=(dataclasses.replace(before, steps=tuple(steps)), after)), TRACE)
    assert rows["copies of other points in the merged cloud"] == ["3", "–"]
    assert rows["too far from the median of their voxel in the merged cloud"] == ["8", "–"]
    assert rows["of a new kind"] == ["5", "–"]
    assert rows["merged by the second thinning"] == ["9 000", "9 000"]
    assert list(rows)[-3:] == ["left after merging", "vertices of the surface", "triangles of the surface"]


def test_repeated_scans_that_were_not_averaged_are_not_said_to_be():
    """Of several the filter left a step each; their mean would have left one."""
    before, after = (
        dataclasses.replace(e, record=dataclasses.replace(e.record, repeated=True)) for e in example_epochs()
    )
    after = dataclasses.replace(after, steps=tuple(s for s in after.steps if s.product != "scan001"))
    rows = rows_of(facts_of(epochs=(before, after)), "The epochs")
    station = "2 scans, repeated from one station"
    assert rows["Measured as"] == [f"{station}, each filtered and merged, not averaged", station]


def test_files_in_another_unit_than_metres_are_said_to_be():
    """Their hashes stand in the report: whoever reads them again must know what their numbers are."""

    def rows(*units: float | None) -> dict[str, list[str]]:
        of_unit = (
            dataclasses.replace(e, record=dataclasses.replace(e.record, unit=unit))
            for e, unit in zip(example_epochs(), units, strict=True)
        )
        return rows_of(facts_of(epochs=tuple(of_unit)), "The epochs")

    assert rows(0.001, 1.0)["Unit of the files"] == ["millimetre", "metre"]
    assert rows(0.3048, None)["Unit of the files"] == ["foot", "not recorded"]
    assert "Unit of the files" not in rows(1.0, None)


def test_told_backwards_the_record_and_the_files_name_reference_and_compared():
    before, after = example_epochs()
    later = dataclasses.replace(before, record=dataclasses.replace(before.record, date=datetime.date(2027, 1, 1)))
    facts = facts_of(epochs=(later, after))
    assert list(dict.fromkeys(row[1] for row in facts.inputs.rows)) == ["reference", "compared"]
    words = {text for s in facts.record for t in s.found for text in (t.title, *t.columns)}
    assert {"reference", "compared", "reference: pairs", "compared: pairs"} <= words
    assert not [text for text in words if text.startswith(("before", "after"))]


def test_settings_that_are_found_from_the_data_are_auto_and_every_input_has_its_hash():
    facts = facts_of()
    filtering = next(s for s in facts.record if s.title == "Filtering each scan")
    assert ("filter.n", "auto") in filtering.settings
    assert ("noise_after", "not known", "not known") in filtering.found[0].rows
    assert [row[-1] for row in facts.inputs.rows] == [f"{k:064x}" for k in (0, 1, 0, 1)]


def test_values_that_are_tables_stand_as_tables_of_their_own():
    facts = facts_of()
    fitting = next(s for s in facts.record if s.title == "Fitting the scans onto each other")
    assert [t.title for t in fitting.found] == ["", "before: pairs", "after: pairs"]
    assert fitting.found[1].columns == ("", "first", "second", "n")
    assert fitting.found[1].rows == (("0", "0", "1", "900"),)
    quality = next(s for s in facts.record if s.title == "Surface against its scans")
    assert [row[0] for row in quality.found[1].rows] == ["scan000", "all"]
    comparison = next(s for s in facts.record if s.title.endswith("comparison of the epochs"))
    assert ("lod95_median_m", "0.00035") in comparison.found[0].rows


def test_scans_that_were_left_where_they_were_are_said_to_be():
    def keep(epoch):
        kept = [dataclasses.replace(s, automatic={**s.automatic, "applied": False}) for s in epoch.steps]
        return dataclasses.replace(epoch, steps=tuple(kept))

    before, after = example_epochs()
    rows = rows_of(facts_of(epochs=(keep(before), after)), "The scans of each epoch")
    assert rows["after adjustment"] == ["poses kept as given", "0.20 mm"]


def test_a_surface_made_again_after_the_comparison_is_pointed_out():
    before, after = example_epochs()
    newer = [dataclasses.replace(s, step_id="x" * 16) if s.product == "surface" else s for s in after.steps]
    facts = facts_of(epochs=(before, dataclasses.replace(after, steps=tuple(newer))))
    assert facts.remarks == ("Epoch e2 was processed again after this comparison; run “monitor compare” anew.",)
    assert facts_of().remarks == ()


def test_share_of_the_area_without_surface_stands_beside_that_of_the_points():
    before, after = example_epochs()
    made = next(s for s in after.steps if s.product == "surface")

    def facts_at(share):
        told = dataclasses.replace(made, automatic={**made.automatic, "uncovered_share": share})
        steps = tuple(told if s is made else s for s in after.steps)
        return facts_of(epochs=(before, dataclasses.replace(after, steps=steps)))

    rows = rows_of(facts_at(0.11), "The scans of each epoch")
    assert rows["Area between the points without surface"][1] == "11 %"
    assert rows["points without surface"][1] == "0.20 %"
    assert facts_at(0.11).remarks == ()
    (remark,) = facts_at(0.984).remarks
    assert plain(remark).startswith("Epoch e2: 98.4 % of the area between its points has no surface")


def test_holes_that_stay_open_are_remarked_and_counted():
    before, after = example_epochs()
    made = next(s for s in after.steps if s.product == "surface")
    for asked, words in (({"watertight": True}, "not watertight"), ({"close_holes": 0.01}, "not closed as asked")):
        left = dataclasses.replace(made, parameters={"surface": asked}, counts={**made.counts, "holes_left_open": 1})
        steps = tuple(left if s is made else s for s in after.steps)
        facts = facts_of(epochs=(before, dataclasses.replace(after, steps=steps)))
        expected = f"The surface of epoch e2 is {words}: 1 hole stays open, since faces over it would meet others."
        assert facts.remarks == (expected,)
    rows = rows_of(facts, "From the scanner to the surface")
    assert rows["holes that could not be closed"][1] == "1"


def test_facts_are_gathered_from_a_project(tmp_path):
    project = Project.create(tmp_path / "p", name="Tor", crs="EPSG:31256")
    record, (before, after) = example_object(), example_epochs()
    project.add_object(record)
    comparison = example_comparison()
    for epoch, side in ((before, comparison.on_reference), (after, comparison.on_compared)):
        project.add_epoch(dataclasses.replace(epoch.record, is_mesh=True, sources=()), mesh=side.surface)
    with pytest.raises(StoreError, match="not compared yet; run: monitor compare"):
        gather_facts(project, "column", "e1", "e2")
    step = dataclasses.replace(after.step("comparison-e1"), step_id="c" * 16)
    project.put("column", "e2", step, comparison)
    facts = gather_facts(project, "column", "e1", "e2")
    assert facts.answer == facts_of().answer
    assert ("Project", "Tor") in facts.object_rows
    assert ("Coordinates", facts.crs) == ("Coordinates", "EPSG:31256") in facts.object_rows
    titles = [t.title for t in (*facts.certainty, *facts.history)]
    assert "The scans of each epoch" not in titles
    assert TRACE not in titles


@pytest.mark.parametrize(("front", "told"), [
    (None, ("front, 70 cm above the base", "right side, 30 cm above the base")),
    (np.pi, ("front, 70 cm above the base", "right side, 30 cm above the base")),
    (0.0, ("back, 70 cm above the base", "left side, 30 cm above the base")),
    (np.pi / 2, ("left side, 70 cm above the base", "front, 30 cm above the base")),
])  # fmt: skip
def test_words_of_place_go_by_the_front_of_the_object(front: float | None, told: tuple[str, str]) -> None:
    facts = facts_of(record=example_object(front=front))
    assert tuple(plain(r.where) for r in facts.regions) == told
    assert facts.front == front


def test_a_front_that_was_given_is_said_to_be_and_stands_with_the_object() -> None:
    guessed, given = facts_of(), facts_of(record=example_object(front=np.pi))
    assert "taken to be where most of the surface faces" in write_captions(guessed).regions
    assert write_captions(given).regions.endswith(
        "Sides are those of someone who stands before the front, which was given with the object: it faces south (180 "
        "degrees clockwise from +y)."
    )
    assert dict(given.object_rows)["Front"] == "faces south (180 degrees clockwise from +y)"
    assert "Front" not in dict(guessed.object_rows)
    room = dataclasses.replace(given, is_room=True)
    assert "before the wall ahead, as given that which faces south (180 degrees" in write_captions(room).regions


@pytest.mark.parametrize(("front", "shows", "hides"), [(None, "Front", "Back"), (0.0, "Back", "Front"),
                                                      (np.pi / 2, "Left side", "Right side")])  # fmt: skip
def test_pictures_are_named_by_the_front_of_the_object(
    monkeypatch: pytest.MonkeyPatch, front: float | None, shows: str, hides: str
) -> None:
    """Region 1, the dent, is at -y."""
    monkeypatch.setattr(pictures, "LARGEST", 120)
    monkeypatch.setattr(pictures, "CLOSE_UP_PIXELS", 120)
    comparison = example_comparison()
    is_stable = np.ones(len(comparison.on_compared.surface.vertices), bool)
    held = dataclasses.replace(comparison.registration, is_stable=is_stable)
    comparison = dataclasses.replace(comparison, registration=held)
    shown = pictures.draw_pictures(facts_of(comparison, example_object(front=front)))
    seen = {v.name: set(v.difference.alt.partition("regions seen: ")[2].split(", ")) for v in shown.views}
    assert "1" in seen[shows]
    assert "1" not in seen[hides]
    sands = {s.name: share(s.picture, SET_ASIDE) for s in shown.stable}
    assert sands[shows] > 3.0 * sands[hides]


def test_the_record_prints_coordinates_whole_and_what_was_not_found_as_unknown():
    assert print_value([1000123.4567, 5300000.0, 150.25]) == "1000123.4567 5300000 150.2"
    assert (print_value(None), print_value([0.00012345, float("nan"), 1234.0])) == ("auto", "0.0001234 not known 1234")
    assert flatten({"a": {"b": None}}, unknown="not known") == [("a.b", "not known")]


def test_a_disagreement_of_scans_of_which_nothing_is_left_is_none_found_and_no_length():
    """It is estimated beside the noise of the scans, and never below 0: "0 mm" would be a claim."""
    first, second = example_epochs()
    steps = tuple(
        dataclasses.replace(s, automatic={"scan_disagreement_m": 0.0}) if s.product == "surface" else s
        for s in first.steps
    )
    rows = rows_of(facts_of(epochs=(dataclasses.replace(first, steps=steps), second)), "The scans of each epoch")
    assert rows["Disagreement left between scans (one sigma)"] == ["none found", "0.090 mm"]
