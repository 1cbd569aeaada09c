"""From how large a change on one is told: the words, the figures, and the dots where only large ones are."""

import dataclasses

import numpy as np
import pytest
from report_examples import example_comparison, facts_of, plain, said, said_below

from reports.captions import write_captions
from reports.smallest import dots_of_legend, dotted_from

NAN = float("nan")


BY_WIDTH = {"told_by_width_m": [[0.025, 0.00118], [0.042, 0.0011], [0.131, 0.00099], [0.2, float("nan")]]}


def test_how_small_a_change_would_have_been_told_is_said_with_its_width():
    facts = facts_of(example_comparison(rows=(), **BY_WIDTH))
    assert said(facts).startswith("No change was found. Between 12 May 2025 and 18 May 2026 no part")
    assert (
        "A change 25 mm wide or wider would have been told from about 1.2 mm on, one 131 mm wide from 0.99 mm on (19 "
        "of 20 such changes, median over the surface)."
    ) in said(facts)
    assert "Region" not in said(facts)
    smallest = facts.answer.figures[1]
    assert (smallest.label, plain(smallest.value)) == ("Smallest change told", "1.2 mm")
    assert plain(smallest.note) == "25 mm wide or wider, 19 of 20 such"
    told = {plain(row[0]): plain(row[1]) for table in facts.certainty for row in table.rows}
    assert told["A change 131 mm wide is told from about (19 of 20 such, median)"] == "0.99 mm"
    assert not any("42 mm wide" in row for row in told)  # it needs nearly as much
    assert told["Level of detection of single places (95 %), median"] == "0.35 mm"


def test_a_wide_change_that_needs_nearly_as_much_is_no_words_worth_and_one_beside_a_layer_is_against_the_rest():
    even = {"told_by_width_m": [[0.025, 0.00118], [0.131, 0.00107]]}
    assert "A change 25 mm wide or wider is told from about 1.2 mm on (19 of 20" in said(
        facts_of(example_comparison(**even))
    )
    layer = {"offset_m": -9.8e-4, "sigma_offset_m": 1e-4, "lod95_beside_layer_median_m": 4.1e-4}
    beside = facts_of(example_comparison(**even, **layer))
    assert "wide or wider is told against the rest from about 1.2 mm on (19 of" in said(beside)
    assert plain(beside.answer.figures[1].note) == "25 mm wide or wider, 19 of 20 such; against the rest"


def test_how_small_a_change_is_told_is_said_not_to_be_known_where_surfaces_state_no_noise():
    untold = example_comparison(told_by_width_m=[[0.025, NAN], [0.131, NAN]])
    unknown = "From how large a change on one is told, by its width, is not known, as {} its noise."
    assert f"median over the surface). {unknown.format('neither surface states')}" in said(facts_of(untold))
    of_scans = dataclasses.replace(untold.on_reference.surface, sigma=np.full(len(untold.on_reference.distances), 1e-4))
    one = dataclasses.replace(untold, on_reference=dataclasses.replace(untold.on_reference, surface=of_scans))
    assert unknown.format("one surface does not state") in said(facts_of(one))
    for known in (example_comparison(**BY_WIDTH), example_comparison()):  # and of older programs
        assert "is not known, as" not in said(facts_of(known))


def test_what_tells_only_large_changes_is_said_with_its_share_and_what_it_tells():
    coarse = {"coarse_from_m": 4 * 0.00035, "coarse_area_share": 0.062, "coarse_told_from_m": 0.0123}
    facts = facts_of(example_comparison(**coarse))
    assert (
        "On 6.2 % of the assessed surface (dotted in the pictures) only larger changes are told: above 1.4 mm, on the "
        "coarsest twentieth of it above 12 mm."
    ) in said(facts)
    notes = {figure.label: plain(figure.note) for figure in facts.answer.figures}
    assert notes["Level of detection"] == "95 %, median, single places; 1.4 mm or more on 6.2 % of the surface"
    told = {plain(row[0]): plain(row[1]) for table in facts.certainty for row in table.rows}
    assert told["assessed surface that tells only changes above 1.4 mm (dotted)"] == "6.2 %"
    assert told["on 95 % of that, changes are told above"] == "12 mm"
    for little in ({}, {**coarse, "coarse_area_share": 0.0004}, {**coarse, "coarse_area_share": NAN}):
        assert "dotted" not in said(facts_of(example_comparison(**little)))


def test_what_is_not_known_of_large_changes_is_left_out():
    """It was said that changes are told "above not known"."""
    coarse = {"coarse_from_m": 0.0014, "coarse_area_share": 0.062, "coarse_told_from_m": float("inf")}
    text = said(facts_of(example_comparison(**coarse)))
    assert "only larger changes are told: above 1.4 mm. " in text
    facts = facts_of(example_comparison(**{**coarse, "coarse_from_m": NAN}))
    assert "(dotted in the pictures) only larger changes are told. " in said(facts)
    assert plain(facts.answer.figures[1].note) == "95 %, median, single places"
    assert "not known" not in "".join(told.text for told in facts.answer.sure if told.subject == "How small")


@pytest.mark.parametrize("side", ["on_compared", "on_reference"])
def test_dots_have_their_words_where_either_surface_has_any(side):
    known = {
        name: dataclasses.replace(s, told_from=np.full(len(s.lod95), 0.001), coarse_from=0.0014)
        for name, s in ((n, getattr(example_comparison(), n)) for n in ("on_compared", "on_reference"))
    }
    plain_facts = facts_of(dataclasses.replace(example_comparison(), **known))
    assert np.isnan(dotted_from(plain_facts.comparison))
    assert "Dotted" not in write_captions(plain_facts).difference
    known[side].told_from[:] = 0.01
    facts = facts_of(dataclasses.replace(example_comparison(), **known))
    assert dotted_from(facts.comparison) == 0.0014
    assert "Dotted: unchanged as far as can be told; only larger changes are told there." in said_below(facts)
    assert dots_of_legend(facts.comparison) == 0.0014


def test_dots_that_nobody_sees_are_not_in_the_legend():
    """One vertex of 6 750 on the figures' side; two dozen can be seen."""
    sides = {n: getattr(example_comparison(), n) for n in ("on_compared", "on_reference")}
    told = {n: dataclasses.replace(s, told_from=np.full(len(s.lod95), 0.001), coarse_from=0.0014)
            for n, s in sides.items()}  # fmt: skip
    comparison = dataclasses.replace(example_comparison(), **told)
    told["on_reference"].told_from[1000] = 0.01
    assert dotted_from(comparison) == 0.0014
    assert np.isnan(dots_of_legend(comparison))
    assert "Dotted" not in write_captions(facts_of(comparison)).difference
    told["on_reference"].told_from[1000:1024] = 0.01
    assert dots_of_legend(comparison) == 0.0014
