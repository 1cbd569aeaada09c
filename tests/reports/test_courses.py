"""How regions go on over several epochs, in words: only what the epochs bear out."""

from dataclasses import replace

import pytest
from series_examples import followed, series_of

from reports.courses import _say_followed, tell_course, tell_series
from reports.quantities import USUAL

NAN = float("nan")


@pytest.mark.parametrize(("area", "text"), [(0.002, "20 cm²"), (0.12349, "1 200 cm²"),
                                            (3.4e-4, "3.4 cm²"), (NAN, "not known")])  # fmt: skip
def test_the_area_of_a_course_has_no_digits_that_nobody_knows(area: float, text: str) -> None:
    """It stood without a margin, with three digits or four."""
    series = series_of("steady", (-1e-4, -4e-4))
    row = series.regions.assign(area_m2=area).iloc[0]
    told = tell_course(series, row, USUAL).area
    assert told.text.replace("\u00a0", " ").replace("\u202f", " ") == text
    assert told.margin == ""


def test_numbers_of_regions_in_one_sentence_have_one_style() -> None:
    assert _say_followed(18, 3).startswith("18 regions are followed, each measured")
    assert _say_followed(18, 3).endswith("; 3 of them go on changing.")
    assert _say_followed(12, 3).endswith("; three of them go on changing.")
    assert _say_followed(7, 7).endswith("; all of them go on changing.")


def test_a_region_that_one_epoch_shows_goes_on_at_no_rate_and_says_when_it_was_measured() -> None:
    told = tell_series(series_of("single", (-3e-4, NAN)))
    (course,) = told.courses
    assert course.course == "measured in one epoch only, which tells no course; last measured in epoch b"
    assert course.rate.text == "no one rate"
    assert course.mean.value == "\u22120.300"
    assert "nothing says that it goes on changing" in told.lead


def test_only_what_goes_on_has_a_rate() -> None:
    rates = {m: tell_series(series_of(m, (-1e-4, -4e-4))).courses[0].rate.text for m in ("steady", "jump", "irregular")}
    assert rates["steady"].replace("\u00a0", " ") == "\u22120.1000 ± 0.0020 mm/year"
    assert rates["jump"] == rates["irregular"] == "no one rate"
    (course,) = tell_series(series_of("irregular", (-4e-4, -1e-4))).courses
    assert course.course == "irregular, no steady course or single jump fits"


def test_a_course_that_bends_tells_its_acceleration_with_its_margin_where_it_is_constant() -> None:
    series = series_of("accelerating", (-1e-4, -4e-4))
    given = {"acceleration_m_per_year2": -5.12e-4, "sigma_acceleration_m_per_year2": 3.1e-5}
    regions = series.regions.assign(**given)
    (course,) = tell_series(replace(series, regions=regions)).courses
    assert course.course.replace("\u00a0", " ") == "faster and faster, by 0.51 ± 0.06 mm/year²"
    slower = regions.assign(acceleration_m_per_year2=5.12e-4)
    (course,) = tell_series(replace(series, regions=slower)).courses
    assert course.course.replace("\u00a0", " ") == "slower and slower, by 0.51 ± 0.06 mm/year²"
    bending = regions.assign(model="bending")
    (course,) = tell_series(replace(series, regions=bending)).courses
    assert course.course == "faster and faster, by no constant acceleration"


def test_what_only_the_last_epoch_shows_is_new_and_may_go_on() -> None:
    series = series_of("jump", (-1e-5, -4e-4))
    told = {}
    for first, last in ((0.0, 1.0), (1.0, 4.0)):
        given = {"onset_from_years": first, "onset_to_years": last}
        told[last] = tell_series(replace(series, regions=series.regions.assign(**given))).courses[0].course
    assert told[1.0].replace("\u00a0", " ") == "at once, between 15 January 2020 and 15 January 2021"
    assert told[4.0].replace("\u00a0", " ") == (
        "new between 15 January 2021 and 15 January 2024; the next epoch will tell whether it goes on"
    )


def test_kinds_that_are_not_told_apart_are_all_said_without_a_date_that_only_one_has() -> None:
    told = {}
    for model in ("accelerating or onset", "bending or stopped", "jump or onset", "jump and rate", "stopped"):
        series = series_of(model, (-1e-4, -4e-4))
        given = {"acceleration_m_per_year2": -5e-4 if model.startswith("acc") else 5e-4}
        if model in ("accelerating or onset", "bending or stopped"):
            given |= {"onset_from_years": NAN, "onset_to_years": NAN}
        facts = tell_series(replace(series, regions=series.regions.assign(**given)))
        told[model] = (facts.courses[0].course.replace("\u00a0", " "), "nothing says" not in facts.lead)
        assert facts.courses[0].rate.text == "no one rate"
    since = "between 15 January 2020 and 15 January 2021"
    assert told == {
        "accelerating or onset": ("faster and faster or began later; the epochs do not tell which", True),
        "bending or stopped": ("slower and slower or came to rest; the epochs do not tell which", False),
        "jump or onset": (f"at once or began later, {since}; the epochs do not tell which", False),
        "jump and rate": (f"goes on beside a jump, {since}", True),
        "stopped": (f"came to rest, {since}", False),
    }


def test_a_series_says_how_small_a_trend_it_tells_and_where_only_larger_ones() -> None:
    told = tell_series(series_of("steady", (-1e-4, -4e-4)))
    assert "told from" not in told.lead  # of an older program: not known
    statistics = {"told_from_median_m_per_year": 7.12e-5, "coarse_from_m_per_year": 2.85e-4, "coarse_area_share": 0.28,
                  "coarse_told_from_m_per_year": 4.21e-3}  # fmt: skip
    series = replace(series_of("steady", (-1e-4, -4e-4)), statistics=statistics)
    lead = tell_series(series).lead.replace("\u00a0", " ")
    usual = "told from about 0.071 mm/year on (19 of 20 such, median over the surface)"
    coarse = "on 28 % of it only above 0.28 mm/year, on the coarsest twentieth of that above 4.2 mm/year."
    assert lead.endswith(f" A steady change is {usual}; {coarse}")
    still = replace(series, regions=series.regions[:0], statistics=statistics | {"coarse_area_share": 0.0009})
    lead = tell_series(still).lead.replace("\u00a0", " ")
    assert lead.endswith(f" No region changed in any of them. A steady change would have been {usual}.")


def test_of_regions_whose_course_nobody_knows_it_is_not_said_that_none_goes_on() -> None:
    series = followed({1: 1, 2: 2})
    for model in ("single", "jump or onset"):
        lead = tell_series(replace(series, regions=series.regions.assign(model=model))).lead
        assert "of none it is told that it goes on changing" in lead


def test_what_is_doubted_of_any_epoch_is_told_with_the_series() -> None:
    series = series_of("steady", (-1e-4, -4e-4))
    doubts = [{"epoch": "b", "of": "pose", "doubt": "a step further fits as well"},
              {"epoch": "a", "of": "scans", "doubt": "scan 2 fits elsewhere"}]  # fmt: skip
    lead = tell_series(replace(series, statistics={"doubts": doubts})).lead
    assert lead.endswith(" In doubt is how epoch b lies on epoch a: a step further fits as well. In doubt is how the "
                         "scans of epoch a lie on each other: scan 2 fits elsewhere.")  # fmt: skip
    assert "doubt" not in tell_series(series).lead
