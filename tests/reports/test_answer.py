"""What the answer of a report says first, of comparisons whose figures are known."""

import dataclasses

import numpy as np
import pytest
from report_examples import (
    DENT,
    PATCH,
    controlled_epochs,
    example_comparison,
    example_epochs,
    example_registration,
    facts_of,
    plain,
    rows_of,
    said,
)

from projects.model import NotAssessed
from reports.captions import write_captions

NAN = float("nan")


def test_regions_beside_a_layer_all_over_say_that_their_figures_are_beside_it():
    figures = {"offset_m": -9.8e-4, "sigma_offset_m": 1e-4, "lod95_beside_layer_median_m": 4.1e-4}
    facts = facts_of(example_comparison(**figures))
    headline = plain(facts.answer.headline)
    assert headline == "Two regions changed against the rest, which lies 0.98 ± 0.20 mm further in."
    assert "scanners whose ranges differ look alike. Say where nothing changed" in said(facts)
    assert "Regions and their figures are beside that" in said(facts)
    assert "The level of detection of single places is 0.35 mm, against the rest 0.41 mm (95 %, median" in said(facts)
    assert plain(facts.answer.figures[1].value) == "0.35 mm, against the rest 0.41 mm"
    assert rows_of(facts, "What can be seen")["of what stands out of the rest, which lies off all over"] == ["0.41 mm"]
    assert "beside what all of the surface lies off by" in write_captions(facts).regions
    alone = facts_of(example_comparison(rows=(), **figures))
    assert "further in" not in said(alone)
    assert "beside" not in write_captions(facts_of(example_comparison())).regions


def test_an_even_change_is_said_to_be_a_layer_or_a_piece_that_moved():
    """A step that sank by 3 mm and a step worn by 3 mm all over are one and the same to two surfaces."""
    facts = facts_of(example_comparison(((DENT[0], "cleaned", *DENT[2:]), (PATCH[0], "coated", *PATCH[2:]))))
    assert "one region lost a thin, even layer (cleaning, weathering) or, if flat, moved inwards as a whole" in said(
        facts
    )
    assert "one gained a thin, even layer (a coating, dirt) or, if flat, moved outwards as a whole (no. 2)" in said(
        facts
    )
    assert said(facts).count("look alike: the surfaces do not tell which it was.") == 1
    told = dict(write_captions(facts).kinds)
    assert told["cleaned"] == "thin, even layer lost or, if flat, piece moved inwards (not told which)"
    assert told["coated"] == "thin, even layer added or, if flat, piece moved outwards (not told which)"
    assert "look alike: the surfaces" not in said(facts_of(example_comparison()))
    wide = facts_of(example_comparison(((DENT[0], "lost", *DENT[2:]), (PATCH[0], "added", *PATCH[2:]))))
    assert dict(write_captions(wide).kinds) == {
        "lost": "material lost, or surface that sank in (not told which)",
        "added": "material added, or surface that bulged out (not told which)",
    }


def test_a_later_epoch_of_another_scale_is_told_in_the_headline():
    comparison = example_comparison()
    scaled = dataclasses.replace(comparison.registration, scale=1.02, sigma_scale=1e-4)
    found = dataclasses.replace(comparison, registration=scaled, regions=comparison.regions.iloc[:0])
    headline = plain(facts_of(found).answer.headline)
    assert headline.endswith("but the later epoch is 1.02000 ± 0.00020 times as large as the earlier one.")
    near = dataclasses.replace(found, registration=dataclasses.replace(scaled, scale=1.00004, sigma_scale=5e-6))
    assert "is 1.000040 ± 0.000010 times as large" in plain(facts_of(near).answer.headline)
    assert plain(facts_of(dataclasses.replace(comparison, registration=scaled)).answer.headline) == plain(
        facts_of(comparison).answer.headline
    )  # regions that stand out are told for all that


def test_the_scale_is_that_of_the_compared_epoch_also_where_it_is_the_earlier_one():
    """The later epoch was said to be 1.02 times as large where it was the reference, and 1.02 times as small."""
    comparison = example_comparison(rows=())
    scaled = dataclasses.replace(comparison.registration, scale=1.02, sigma_scale=1e-4)
    backwards = facts_of(dataclasses.replace(comparison, registration=scaled), epochs=example_epochs()[::-1])
    headline = plain(backwards.answer.headline)
    assert headline.endswith("but the earlier epoch is 1.02000 ± 0.00020 times as large as the later one.")


def test_the_figure_of_the_whole_says_in_words_whether_it_moved():
    def note(**statistics):
        figures = facts_of(example_comparison(**statistics), epochs=controlled_epochs()).answer.figures
        return plain(next(f.note for f in figures if f.label == "Object as a whole"))

    assert note().endswith("; significant (confidence above 99.9 %)")
    assert note(motion_is_significant=False, motion_significance=0.907).endswith(
        "; not significant (confidence 90.7 %)"
    )


@pytest.mark.parametrize(
    ("epochs", "statistics"),
    [(example_epochs, {}), (controlled_epochs, {"motion_significance": NAN, "motion_is_significant": None})],
)
def test_where_frames_are_not_known_no_motion_is_told_and_no_confidence(epochs, statistics):
    """An object that nobody touched had moved by 0.67 ± 0.03 mm, with a confidence above 99.9 %."""
    facts = facts_of(example_comparison(**statistics), epochs=epochs())
    figure = facts.answer.figures[2]
    assert (figure.label, figure.value) == ("Motion of the whole", "not assessable")
    assert plain(figure.note).startswith("coordinates differ by 3.20 ± 0.10 mm, turned by 0.00")
    assert "how well the coordinates of both epochs agree is not known without control points" in said(facts)
    assert "moved is not assessable: its coordinates differ by 3.20 ± 0.10 mm, turned by" in said(facts)
    registered = next(t for t in facts.certainty if t.title == "Registration of the epochs")
    rows = dict(registered.rows)
    assert plain(rows["Coordinates of the object differ by"]) == "3.20 ± 0.10 mm"
    assert rows["confidence that it moved (1 − p)"].startswith("not assessable: how well the coordinates of both")
    assert plain(registered.note).endswith("95 % interval, of the fit of the two surfaces alone.")
    by_axis = next(t for t in facts.certainty if t.title == "By how much the coordinates differ, axis by axis")
    assert "As a motion this is not assessable" in by_axis.note
    everything = plain(" ".join((said(facts), *(f.note for f in facts.answer.figures), str(facts.record))))
    for word in ("99.9", "0.9999", "significant (", "from where it stood"):
        assert word not in everything


def with_assessed(share):
    """Return the example without a change, of which only the lowest share of the vertices was assessed."""
    comparison = example_comparison(rows=(), assessed_area_share=share)
    side = comparison.on_compared
    known = np.arange(len(side.assessment)) < share * len(side.assessment)
    unassessed = dataclasses.replace(side, assessment=np.where(known, 1, 0).astype(np.uint8))
    return dataclasses.replace(comparison, on_compared=unassessed)


def test_where_little_or_nothing_was_assessed_the_headline_says_so():
    assert facts_of(with_assessed(0.95)).answer.headline == "No change was found."
    little = plain(facts_of(with_assessed(0.2)).answer.headline)
    assert little == "No change was found on the 20 % of the surface that could be assessed."
    text = said(facts_of(with_assessed(0.0)))
    assert text.startswith("Nothing could be assessed. Whether anything changed between 12 May 2025 and 18 May 2026 is")
    assert "no part of the surface" not in text
    n_regions = facts_of(with_assessed(0.0)).answer.figures[0]
    assert (n_regions.value, n_regions.note) == ("not known", "nothing could be assessed")


def test_where_the_later_epoch_recorded_little_the_headline_says_so():
    comparison = example_comparison(rows=(), assessed_area_share=0.92, assessed_area_share_reference=0.28)
    facts = facts_of(comparison)
    assert plain(facts.answer.headline) == "No change was found on the 28 % of the surface that could be assessed."
    assert "72 % of the earlier epoch’s surface could not be assessed" in said(facts)


def test_an_unchanged_surface_that_lies_off_as_a_whole_is_no_answer_of_no_change():
    layer = {"offset_m": -9.8e-4, "sigma_offset_m": 1e-4, "offset_is_told": True}
    facts = facts_of(example_comparison(rows=(), **layer))
    headline = plain(facts.answer.headline)
    assert headline == "No part changed against the rest, but the surface as a whole lies 0.98 ± 0.20 mm further in."
    assert "A layer taken off (cleaning, weathering) nearly everywhere and scanners whose ranges differ" in said(facts)
    raised = facts_of(example_comparison(rows=(), **{**layer, "offset_m": 9.8e-4}))
    assert "0.98 ± 0.20 mm further out on average. A layer laid on (a coating, dirt) nearly" in said(raised)
    little = {"assessed_area_share": 0.92, "assessed_area_share_reference": 0.28}
    seen = plain(facts_of(example_comparison(rows=(), **layer, **little)).answer.headline)
    assert seen.startswith(
        "No part changed against the rest on the 28 % of the surface that could be assessed, but the"
    )
    with_regions = facts_of(example_comparison(**layer))
    assert with_regions.answer.headline == "Two regions changed."
    assert "What is not called changed lies 0.98 ± 0.20 mm further in on average" in said(with_regions)
    assert "further in" not in said(facts_of(example_comparison(**{**layer, "offset_is_told": False})))
    absolute = said(facts_of(example_comparison(mode="absolute", **layer)))
    assert "0.98 ± 0.20 mm further in on average, a motion of the whole included. A layer taken off" in absolute
    assert "nearly everywhere, such a motion and scanners whose ranges differ look alike" in absolute


@pytest.mark.parametrize("mode", ["relative", "absolute"])
def test_an_object_that_moved_as_a_whole_and_otherwise_did_not_is_no_answer_of_no_change(mode):
    moved = facts_of(example_comparison(rows=(), mode=mode), epochs=controlled_epochs())
    assert plain(moved.answer.headline) == (
        "No part changed against the rest, but the object as a whole moved by 3.20 ± 0.10 mm."
    )
    still = example_comparison(rows=(), mode=mode, motion_is_significant=False)
    assert facts_of(still, epochs=controlled_epochs()).answer.headline == "No change was found."


def test_two_regions_are_told_with_their_place_size_and_margins():
    text = said(facts_of())
    assert text.startswith("Two regions changed. Between 12 May 2025 and 18 May 2026 one region lost material (no. 1)")
    assert "and one gained material (no. 2); together they cover about 110 cm²." in text
    assert "Region 1 (front, 70 cm above the base): 78 ± 4 cm², at its deepest −12.40 ± 0.29 mm, volume −31.0" in text
    assert "Region 2 (right side, 30 cm above the base): 31.0 ± 2.0 cm², at its highest +3.1 ± 0.4 mm" in text
    assert "The level of detection of single places is 0.35 mm (95 %, median over the surface)." in text  # of old ones
    assert "5.3 % of the earlier epoch’s surface could not be assessed, mostly because" in text
    assert "; of the later epoch’s it is 4.7 %." in text


@pytest.mark.parametrize(
    ("scale", "area", "volume"),
    [(1e-3, "7.8 ± 0.4 mm²", "−31.0 ± 1.6 mm³"), (1e3, "7.8 ± 0.4 m²", "−31.0 ± 1.6 dm³")],
)
def test_regions_of_a_small_and_of_a_wide_object_are_told_in_its_units(scale, area, volume):
    rows = [(*r[:2], *(scale * v for v in r[2:6]), *r[6:]) for r in (DENT, PATCH)]
    facts = facts_of(example_comparison(rows=rows))
    assert plain(facts.regions[0].area.text) == area
    assert plain(facts.regions[0].volume.text) == volume
    assert (facts.measures.area, facts.measures.volume) == (area.split()[-1], volume.split()[-1])
    assert f"Region 1 (front, 70 cm above the base): {area}, at its deepest" in said(facts)


def test_numbers_of_regions_in_one_sentence_have_one_style():
    rows = tuple((k, "lost" if k < 15 else "added", *DENT[2:]) for k in range(1, 19))
    text = said(facts_of(example_comparison(rows)))
    assert "14 regions lost material and 4 gained material" in text
    assert "two" not in text.partition("; together")[0]


def test_where_scans_hold_nothing_is_told_with_all_that_it_may_be():
    text = said(facts_of(example_comparison(met_nothing_area_m2=[12.4e-4, 0.0])))
    assert (
        "In the direction of 12.4 cm² of the earlier epoch’s surface the later epoch’s scans hold nothing: it is gone, "
        "or it or something before it was too dark for them, or it was cut out of the files."
    ) in text
    assert text.count("hold nothing") == 1
    comparison = example_comparison(met_nothing_area_m2=[12.4e-4, 0.0])
    side = comparison.on_reference
    x, y, z = side.surface.vertices.T
    is_tip = (z > 0.9) & (y < -0.8 * np.hypot(x, y))
    speck = (np.abs(z - 0.4) < 0.02) & (y > 0.9 * np.hypot(x, y))
    reasons = np.where(is_tip | speck, NotAssessed.MET_NOTHING, side.reasons).astype(np.uint8)
    at_top = dataclasses.replace(comparison, on_reference=dataclasses.replace(side, reasons=reasons))
    assert "12.4 cm² of the earlier epoch’s surface (front, 95 cm above the base) the later" in said(facts_of(at_top))
    text = said(facts_of(example_comparison(met_nothing_area_m2=[0.0, 30e-4])))
    assert "of 30.0 cm² of the later epoch’s surface the earlier epoch’s scans hold nothing: it is new, or" in text
    assert "hold nothing" not in said(facts_of())


def test_many_regions_are_counted_and_only_the_largest_are_told():
    rows = [(k, *DENT[1:]) for k in range(1, 16)]
    text = said(facts_of(example_comparison(rows=rows)))
    assert text.startswith("15 regions changed. Between 12 May 2025 and 18 May 2026 15 regions lost material; together")
    assert "Region 3 (" in text
    assert "Region 4 (" not in text
    assert "The largest of them follow; all stand in the table of regions." in text


def test_control_in_both_epochs_and_the_absolute_mode_say_that_the_object_moved():
    text = said(facts_of(example_comparison(mode="absolute"), epochs=controlled_epochs()))
    assert "stands 3.20 ± 0.10 mm from where it stood" in text
    assert "this is contained in the differences." in text
    assert "control" not in text


def test_where_the_motion_of_the_whole_is_in_the_differences_no_part_is_said_to_have_moved():
    rows = [(*DENT[:1], "moved", *DENT[2:]), PATCH]
    assert "moved as a part" in said(facts_of(example_comparison(rows=rows)))
    for epochs in (example_epochs(), controlled_epochs()):
        text = said(facts_of(example_comparison(rows=rows, mode="absolute"), epochs=epochs))
        assert "moved, as a part or with the whole" in text
        assert "moved as a part" not in text
    unmoved = example_comparison(rows=rows, mode="absolute", motion_is_significant=False)
    assert "moved as a part" in said(facts_of(unmoved, epochs=controlled_epochs()))


def test_a_motion_within_its_margin_is_no_motion():
    comparison = example_comparison(motion_is_significant=False, motion_significance=0.4)
    comparison = dataclasses.replace(comparison, registration=example_registration(2e-5))
    text = said(facts_of(comparison, epochs=controlled_epochs()))
    assert "The object as a whole did not measurably move (0.02 ± 0.10 mm" in text


def test_a_tolerance_is_reported_where_one_was_given():
    figures = {"tolerance_m": 0.01, "share_beyond_tolerance": 0.0052, "share_changed_beyond_tolerance": 0.0031}
    text = said(facts_of(example_comparison(**figures)))
    assert "0.31 % of the assessed surface changed by more than the tolerance of 10 mm." in text
    assert "tolerance" not in said(facts_of())
    text = said(facts_of(example_comparison(**figures, share_coarser_than_tolerance=0.043)))
    assert "changed by more than the tolerance of 10 mm; 4.3 % tells only larger changes than that." in text
    exact = said(facts_of(example_comparison(**{**figures, "tolerance_m": 0.000625})))
    assert "more than the tolerance of 0.625 mm." in exact
    rows = rows_of(facts_of(example_comparison(**figures)), "What can be seen")
    assert rows["assessed surface that differs by more, by errors or by change"] == ["0.52 %"]
    assert rows["assessed surface that changed by more (significant)"] == ["0.31 %"]


def test_what_differs_by_error_is_not_told_as_beyond_the_tolerance():
    """45 % "differs by more than 2 mm" beside a level of detection of 5 mm and 1.8 % changed."""
    figures = {"tolerance_m": 0.002, "share_beyond_tolerance": 0.45, "lod95_median_m": 0.0051}
    changed = {**figures, "share_changed_beyond_tolerance": 0.018, "share_coarser_than_tolerance": NAN}
    text = said(facts_of(example_comparison(**changed)))
    assert "1.8 % of the assessed surface changed by more than the tolerance of 2 mm. This survey does not tell" in text
    assert "tell changes as small as that: the level of detection of single places is 5.1 mm." in text
    assert "45 %" not in text
    old = said(facts_of(example_comparison(**figures)))
    assert (
        "45 % of the assessed surface differs by more than the tolerance of 2 mm, by errors or by change. This" in old
    )
    wide = said(facts_of(example_comparison(**changed, told_by_width_m=[[0.07, 0.0031]])))
    assert "small as that: changes are told only from about 3.1 mm on." in wide
    told = said(facts_of(example_comparison(**changed, told_by_width_m=[[0.07, 0.0011]])))
    assert "the tolerance of 2 mm. A change" not in told
    assert "as small as that" not in told


def test_what_scans_disagree_by_is_told_as_it_counts_in_regions():
    row = "of the same, counted in the mean of patches and regions"
    for scales, words in (([0.28], "28 %"), ([0.28, 1.2], "28 %, and 120 % of what is beyond 0.21 mm"),
                          ([1.19, 1.0], "119 %, and 100 % of what is beyond 0.21 mm")):  # fmt: skip
        figures = {"error_scales_scans": scales, "error_steps_scans_m": [0.0, 2.1e-4][: len(scales)]}
        facts = facts_of(example_comparison(error_scale_shared=0.07, **figures))
        told = {plain(r[0]): plain(r[1]) for table in facts.certainty for r in table.rows}
        assert told[row] == words
    assert not any(row == plain(r[0]) for t in facts_of(example_comparison()).certainty for r in t.rows)


def test_parts_that_moved_are_told_before_the_regions_that_are_none_of_theirs():
    def part(*regions, turn):
        covariance = np.diag([1e-4] * 3 + [2.5e-5] * 3) ** 2  # 0.1 mrad and 0.025 mm
        return {"centre": [0.1, 0.2, 0.3], "motion": [0.0, 0.0, turn, 0.003, 0.0, -0.004], "covariance": covariance,
                "regions": list(regions)}  # fmt: skip

    facts = facts_of(example_comparison(parts=[part(2, turn=0.01)]))
    assert plain(facts.answer.headline) == "One part moved, and one other region changed."
    text = said(facts)
    assert (
        "Part 1 (region 2) moved as a whole against the rest, by 5.00 ± 0.05 mm and turned by 0.573° ± 0.011°." in text
    )
    assert "Region 1 (" in text
    assert "Region 2 (" not in text  # its volume is that of no material
    facts = facts_of(example_comparison(parts=[part(1, turn=1e-4), part(2, turn=0.01)]))
    assert plain(facts.answer.headline) == "Two parts moved."
    assert "Part 1 (region 1) moved as a whole against the rest, by 5.00 ± 0.05 mm. Part 2" in said(facts)


@pytest.mark.parametrize(
    ("sigma_turn", "told"),
    [
        (1e-4, "turned as a whole against the rest, by 0.573° ± 0.011°; its middle did not measurably move (5 ± 10"),
        (1e-2, "moved as a whole against the rest; how much of it is a shift (5 ± 10 mm) and how much a turn "
               "(0.6° ± 1.1°) cannot be told apart."),
    ],
)  # fmt: skip
def test_a_shift_within_its_margin_is_not_told_as_how_far_a_part_moved(sigma_turn: float, told: str) -> None:
    part = {"centre": [0.1, 0.2, 0.3], "motion": [0.0, 0.0, 0.01, 0.003, 0.0, -0.004],
            "covariance": np.diag([sigma_turn] * 3 + [5e-3] * 3) ** 2, "regions": [2]}  # fmt: skip
    assert f"Part 1 (region 2) {told}" in said(facts_of(example_comparison(parts=[part])))


def test_an_area_that_is_hardly_known_is_told_so_in_answer_table_and_note():
    hardly = (*DENT[:3], 0.0082, *DENT[4:])  # 78 cm2, with a margin of 161
    facts = facts_of(example_comparison(rows=(hardly, PATCH)))
    assert "together they cover about 100 cm², which is not well known." in said(facts)
    assert "): about 80 cm² (not well known, up to 240 cm²), at its deepest" in said(facts)
    assert plain(facts.regions[0].area.beside) == "up to 240"
    assert "Up to: the upper end" in write_captions(facts).regions
    assert "Up to" not in write_captions(facts_of()).regions


def test_a_layer_within_its_margin_is_no_headline():
    figures = {"offset_m": 0.8e-4, "sigma_offset_m": 2.5e-4, "lod95_beside_layer_median_m": 4.1e-4}
    facts = facts_of(example_comparison(**figures))
    assert plain(facts.answer.headline) == "Two regions changed."
    assert "Regions and their figures are beside that" in said(facts)


def test_where_all_of_it_lies_off_it_is_not_said_that_nothing_changed():
    facts = facts_of(example_comparison(rows=(), offset_is_told=True, offset_m=0.002, sigma_offset_m=1e-4))
    text = said(facts)
    assert "no part of the surface that could be assessed stands out of the rest by more than errors" in text
    assert "changed by more than errors" not in text
    assert plain(facts.answer.figures[0].note) == "beside what all of the surface differs by"


def test_epochs_of_one_day_are_told_apart():
    before, after = example_epochs()
    same = dataclasses.replace(after, record=dataclasses.replace(after.record, date=before.record.date, label=""))
    text = said(facts_of(epochs=(before, same)))
    assert "Between 12 May 2025 (epoch e1) and 12 May 2025 (epoch e2)" in text


def test_a_motion_of_the_whole_that_is_in_the_differences_is_in_the_headline():
    """A ball that stood 6 mm beside its place: "Seven regions changed.", of which none had."""
    facts = facts_of(example_comparison(mode="absolute"), epochs=controlled_epochs())
    headline = plain(facts.answer.headline)
    assert headline.startswith(
        "The object as a whole moved by 3.20 ± 0.10 mm; two regions changed, with it or apart from it"
    )
    unmoved = example_comparison(mode="absolute", motion_is_significant=False)
    assert plain(facts_of(unmoved, epochs=controlled_epochs()).answer.headline) == "Two regions changed."
    turned = dataclasses.replace(example_comparison(mode="absolute"), registration=example_registration(2e-5))
    assert "as a whole turned by" in plain(facts_of(turned, epochs=controlled_epochs()).answer.headline)
