"""Followed regions are found again: in the words and by the numbers of the comparison that ends their series."""

import dataclasses

import numpy as np
import pandas as pd
from report_examples import column, example_comparison, facts_of
from series_examples import followed
from shown_examples import DOT, pictures_of, text_of

from reports.courses import tell_series
from reports.exports import export_series
from reports.followed import place_courses
from reports.html import fill_page
from reports.pdf import set_document
from reports.quantities import NBSP

BEHIND = 9  # a followed region on the back that is none of the comparison


def test_a_followed_region_lies_where_the_table_of_regions_says_and_has_its_number_there() -> None:
    facts = facts_of()
    told = place_courses(tell_series(followed({5: 2, 7: 1, BEHIND: 0})), facts.comparison)
    where = {r.number: r.where for r in facts.regions}
    placed = {c.number: (c.where, c.on_map.replace(NBSP, " ")) for c in told.courses}
    assert placed == {5: (where[2], "no. 2"), 7: (where[1], "no. 1"), BEHIND: (f"back, 50{NBSP}cm above the base", "–")}


def test_followed_regions_are_told_from_the_front_that_was_given(tmp_path) -> None:
    """The regions of the comparison are at -y (1) and +x (2), the other at +y."""
    series, comparison = followed({5: 2, 7: 1, BEHIND: 0}), facts_of().comparison
    told = place_courses(tell_series(series), comparison, bearing=0.0)
    sides = {c.number: c.where.partition(",")[0] for c in told.courses}
    assert sides == {5: "left side", 7: "back", BEHIND: "front"}
    export_series(tmp_path, "column", series, comparison, (), bearing=0.0)
    (table,) = tmp_path.glob("*_series_regions.csv")
    places = pd.read_csv(table).set_index("identity")["place"]
    assert {k: v.partition(",")[0] for k, v in places.items()} == sides


def test_what_is_part_of_a_region_lies_where_its_own_footprint_does() -> None:
    series = followed({5: 2, 7: 2})
    half = np.where(column()[1] > 0.3, series.identity, np.where(series.identity == 5, 7, 0)).astype(np.int32)
    regions = series.regions.assign(z=[0.33, 0.27])
    told = place_courses(tell_series(dataclasses.replace(series, identity=half, regions=regions)), example_comparison())
    placed = {c.number: (c.where.replace(NBSP, " "), c.on_map.replace(NBSP, " ")) for c in told.courses}
    assert placed == {
        5: ("right side, 33 cm above the base", "no. 2"),
        7: ("right side, 27 cm above the base", "no. 2"),
    }


def test_what_merged_into_another_has_its_number_on_the_map() -> None:
    """Region 7 went into 5, and 5 into 9, which is the comparison's region 2."""
    series = followed({5: 0, 7: 0, BEHIND: 2})
    regions = series.regions.assign(merged_into=series.regions["identity"].map({5: BEHIND, 7: 5, BEHIND: 0}))
    told = place_courses(tell_series(dataclasses.replace(series, regions=regions)), example_comparison())
    assert {c.number: c.on_map.replace(NBSP, " ") for c in told.courses} == dict.fromkeys((5, 7, BEHIND), "no. 2")
    assert {c.number: c.origin for c in told.courses} == {
        5: f"merged into {BEHIND}, which tells of it since, in all epochs with what was 7",
        7: "merged into 5, which tells of it since",
        BEHIND: "in all epochs with what was 5",
    }


def test_of_a_surface_that_was_made_again_only_the_place_is_told() -> None:
    series = followed({BEHIND: 0})
    one = np.zeros(1)
    other = dataclasses.replace(series, identity=np.ones(1, np.int32), rate=one, sigma_rate=one, acceleration=one,
                                sigma_acceleration=one)  # fmt: skip
    (course,) = place_courses(tell_series(other), example_comparison()).courses
    assert course.where == f"50{NBSP}cm above the base"


def test_place_and_number_stand_in_page_document_and_table(tmp_path) -> None:
    series, facts = followed({5: 2, BEHIND: 0}), facts_of()
    facts = dataclasses.replace(facts, series=place_courses(tell_series(series), facts.comparison))
    shown = dataclasses.replace(pictures_of(facts), courses=DOT)
    page = fill_page(facts, shown)
    section = page[page.index('id="series"') : page.index('id="distribution"')]
    assert f'<td class="words">no.{NBSP}2</td>' in section
    assert f'<td class="words">back, 50{NBSP}cm above the base</td>' in section
    assert section.count('<td class="said" colspan="2">no one rate</td>') == 4
    text = text_of(set_document(facts, pictures_of(facts)))
    text = text[text.index("Through time") : text.index("All differences")]
    assert "no. 2" in text
    assert "back, 50 cm" in text
    export_series(tmp_path, "column", series, facts.comparison, ())
    table = pd.read_csv(tmp_path / "column_a_series_regions.csv")
    assert list(table.columns[-2:]) == ["place", "last_region"]
    assert table["place"].tolist() == ["right side, 30 cm above the base", "back, 50 cm above the base"]
    assert table["last_region"].tolist() == [2, 0]
