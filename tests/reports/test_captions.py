"""What stands below the pictures and the tables of a report."""

import dataclasses

import numpy as np
from report_examples import DENT, PATCH, example_comparison, facts_of, plain, said_below

from projects.triangles import vertex_areas
from reports.captions import COURSES, caption_region, write_captions


def test_why_a_volume_or_a_margin_is_not_known_stands_below_the_table():
    nan = float("nan")
    without_volume, vague = (*PATCH[:4], nan, nan, *PATCH[6:]), (*DENT[:7], nan, *DENT[8:])
    told = plain(write_captions(facts_of(example_comparison((vague, without_volume)))).regions)
    assert "The volume of no. 2 is not known: too little of what lies there and beside could be assessed" in told
    assert "The margin of the extreme of no. 1 is not known: at edges and rims" in told
    assert "not known" not in write_captions(facts_of()).regions
    both = example_comparison(((*DENT[:4], nan, nan, *DENT[6:]), without_volume))
    assert "The volume of nos. 1 and 2 is" in plain(write_captions(facts_of(both)).regions)
    shapes = {"region_shapes": [{"region": k, "is_hollow": True} for k in (1, 2)]}
    hollows = dataclasses.replace(both, statistics={**both.statistics, **shapes})
    assert "too little of what lies there" not in write_captions(facts_of(hollows)).regions  # told with the hollows


def test_what_is_told_of_a_hollow_is_explained_below_the_table():
    comparison = example_comparison()
    assert "hollow" not in write_captions(facts_of(comparison)).regions
    shapes = [{"region": 1, "is_hollow": True}, {"region": 2, "is_hollow": False}, {"region": 99, "is_hollow": True}]
    told = dataclasses.replace(comparison, statistics={**comparison.statistics, "region_shapes": shapes})
    assert "No. 1 is a hollow too narrow to have a surface, such as a crack" in write_captions(facts_of(told)).regions
    shapes[1]["is_hollow"] = True
    assert "Nos. 1 and 2 are hollows too narrow to have a surface" in write_captions(facts_of(told)).regions


def test_the_legend_says_that_its_colours_are_of_this_comparison():
    assert "their scale is this comparison’s own" in write_captions(facts_of()).difference


def test_of_what_lies_flat_it_is_said_which_side_is_taken_for_the_front():
    facts = facts_of()
    flat = dataclasses.replace(facts, is_flat=True)
    assert "taken to be the lower edge of the view from above" in write_captions(flat).regions
    assert "lies flat" not in write_captions(facts).regions
    assert "lies flat" not in write_captions(dataclasses.replace(flat, front=0.5)).regions


def test_a_report_printed_in_grey_says_where_loss_and_gain_are_told_apart():
    """Both ends of the colours are as dark."""
    assert said_below(facts_of()).endswith(
        " Numbers are those of the table of regions, which also says without colour what was lost and what gained."
    )
    one = said_below(facts_of(example_comparison(rows=[DENT])))
    assert one.endswith(" Numbers are those of the table of regions.")
    assert "Numbers" not in said_below(facts_of(example_comparison(rows=())))


def test_a_section_says_that_the_extreme_may_lie_beside_it():
    """+5.4 mm at the dot of one section, the extreme of its region +11.2 mm."""
    facts = facts_of()
    assert caption_region(facts.regions[0], facts).endswith("the extreme is of several places, anywhere in the region.")


def test_every_mark_of_a_course_is_explained():
    assert all(mark in COURSES for mark in ("Diamond: the first epoch.", "Filled: ", "hollow: ", "Line and band"))


def test_colours_of_a_part_that_moved_are_said_to_be_no_loss():
    told = "Where a part moved, warm is what went in and blue what came out."
    moved = example_comparison(rows=[(*DENT[:1], "moved", *DENT[2:]), PATCH])
    assert told in said_below(facts_of(moved))
    assert told not in said_below(facts_of())


def test_closed_holes_are_named_where_pictures_and_shares_show_them():
    """Before and after drew 231 invented triangles as stone, and no word said that nothing was measured there."""
    open_ = example_comparison()
    side = open_.on_compared
    invented = np.arange(len(side.surface.faces)) < 9
    surface = dataclasses.replace(side.surface, face_invented=invented)
    sides = (open_.on_reference, side)
    whole = [float(vertex_areas(s.surface.vertices, s.surface.faces).sum()) for s in sides]
    areas = {"areas_by_assessment_m2": [{"unchanged": area} for area in whole]}
    open_ = dataclasses.replace(open_, statistics={**open_.statistics, **areas})
    closed = dataclasses.replace(open_, on_compared=dataclasses.replace(side, surface=surface))
    told = write_captions(facts_of(closed))
    assert told.strips.endswith(" Hatched: a hole that was closed, nothing was measured there.")
    assert "Hatched: not assessable; also a hole that was closed, which no share counts." in told.difference
    notes = [t.note for t in facts_of(closed).certainty if t.title == "What could be assessed"]
    assert notes == ["Of the area of each surface, less its edge beyond its points and what closes its holes."]
    assert not [word for word in write_captions(facts_of(open_)).__dict__.values() if "closed" in str(word)]


def test_an_edge_that_is_hatched_and_in_no_share_is_named():
    """8.2 % of the picture was hatched where 0.85 % was said to be not assessable."""
    comparison = example_comparison()
    sides = (comparison.on_reference, comparison.on_compared)
    whole = [float(vertex_areas(s.surface.vertices, s.surface.faces).sum()) for s in sides]
    for share, is_told in ((1.0, False), (0.93, True)):
        areas = {"areas_by_assessment_m2": [{"unchanged": share * area} for area in whole]}
        counted = dataclasses.replace(comparison, statistics={**comparison.statistics, **areas})
        told = "Hatched: not assessable; also the edge beyond the points, which no share counts."
        assert (told in said_below(facts_of(counted))) == is_told
