"""Numbers as they are printed: rounded by their margin, never a NaN, never a minus before zero."""

import datetime
import math
import re
from pathlib import Path

import pytest

from reports import quantities
from reports.quantities import (
    NAN,
    Estimate,
    about_square,
    choose_measures,
    coordinates,
    count,
    day,
    estimate,
    estimate_size,
    height,
    in_words,
    listed,
    millimetres,
    percent,
    square,
    tell_bearing,
)  # fmt: skip


@pytest.mark.parametrize(
    ("value", "sigma", "text"),
    [
        (-0.0124, 0.00015, "−12.40 ± 0.29 mm"),  # a margin that begins with 1 or 2 keeps two digits
        (-0.0124, 0.00025, "−12.4 ± 0.5 mm"),
        (0.00321, 0.0, "+3.21 mm"),
        (1.2345, 0.02, "+1\u202f230 ± 40 mm"),
        (0.0, 0.0001, "0.00 ± 0.20 mm"),
        (-1e-9, 0.0001, "0.00 ± 0.20 mm"),
        (NAN, 0.0001, "not known"),
        (0.003, NAN, "+3.0 mm (margin not known)"),
    ],
)
def test_an_estimate_is_rounded_by_its_margin_of_95_percent(value, sigma, text):
    assert estimate(value, sigma, 1e3, "mm", signed=True).text.replace("\u00a0", " ") == text


def test_beside_its_value_a_margin_that_is_not_known_is_said_in_words():
    told = [estimate(0.003, sigma, 1e3, "mm").beside.replace("\u00a0", " ") for sigma in (NAN, 0.0, 0.0005)]
    assert told == ["margin not known", "", "± 1.0"]


@pytest.mark.parametrize(
    ("area", "sigma", "text", "beside"),
    [
        (0.00198, 0.0041, "about 20 cm² (not well known, up to 110 cm²)", "up to 110"),
        (0.00002, 0.00002, "about 0.2 cm² (not well known, up to 0.60 cm²)", "up to 0.60"),
        (0.00198, 0.0004, "20 ± 8 cm²", "± 8"),
        (0.00198, NAN, "20 cm² (margin not known)", "margin not known"),
        (NAN, NAN, "not known", ""),
    ],
)
def test_an_area_known_no_better_than_it_is_large_is_told_by_how_large_it_may_be(area, sigma, text, beside):
    told = estimate_size(area, sigma, 1e4, "cm²")
    assert (told.text.replace("\u00a0", " "), told.beside.replace("\u00a0", " ")) == (text, beside)


@pytest.mark.parametrize(
    ("area", "sigma", "text"),
    [
        (0.00436, 0.0044, "about 40 cm², which is not well known"),
        (0.0121, 0.0016, "about 120 cm²"),
        (0.0103, 0.00148, "about 100 cm²"),
        (0.01095, 0.0003, "about 110 cm²"),
        (0.01095, 1e-9, "about 110 cm²"),
        (3.456, 0.01, "about 3.46 m²"),
        (0.00436, NAN, "43.6 cm²"),
    ],
)
def test_a_sum_of_areas_has_the_digits_that_its_margin_leaves(area, sigma, text):
    assert about_square(area, sigma).replace("\u00a0", " ") == text


def test_what_is_no_number_says_so():
    assert [
        e.is_words for e in (Estimate("no one rate"), estimate(NAN, 1.0, 1.0, "mm"), estimate(1.0, 1.0, 1.0, "mm"))
    ] == [True, True, False]


def test_a_margin_is_never_told_as_none():
    assert estimate(1.2e-10, 3e-12, 1e6, "cm³").text.replace("\u00a0", " ") == "0.000120 ± 0.000006 cm³"
    assert estimate(1.2e-4, 1e-14, 1e3, "mm").text.replace("\u00a0", " ") == "0.120000 ± < 0.000001 mm"


def test_a_degree_sign_stands_at_the_value_and_at_the_margin():
    assert estimate(0.107, 0.02, 1.0, "°").text.replace("\u00a0", " ") == "0.11° ± 0.04°"


@pytest.mark.parametrize(
    ("share", "text"),
    [(0.0, "0 %"), (1.0, "100 %"), (0.1289, "13 %"), (0.0468, "4.7 %"), (0.0031, "0.31 %"), (0.996, "99.60 %"),
     (1e-6, "< 0.01 %"), (1 - 1e-6, "> 99.99 %"), (NAN, "not known"),
     (-2.2e-16, "0 %"), (1e-16, "0 %"), (1.0 - 2.2e-16, "100 %"), (1.0 + 2.2e-16, "100 %")],
)  # fmt: skip
def test_a_share_has_more_digits_the_nearer_it_is_to_none_or_all(share, text):
    assert percent(share).replace("\u00a0", " ") == text


def test_lengths_are_said_in_the_unit_that_one_would_say():
    said = [height(v).replace("\u00a0", " ") for v in (0.0123, 0.0994, 0.0996, 0.7, 0.994, 0.996, 1.234, NAN)]
    assert said == ["12 mm", "99 mm", "10 cm", "70 cm", "99 cm", "1.00 m", "1.23 m", "not known"]
    assert millimetres(0.000353).replace("\u00a0", " ") == "0.35 mm"
    assert millimetres(NAN) == "not known"


def test_words_do_not_depend_on_the_language_of_the_machine():
    assert day(datetime.date(2025, 3, 1)).replace("\u00a0", " ") == "1 March 2025"
    assert [in_words(n) for n in (0, 2, 12, 13)] == ["no", "two", "twelve", "13"]
    assert listed(["1"]) == "1"
    assert listed(["1", "2", "3"]) == "1, 2 and 3"
    assert count(1234567) == "1\u202f234\u202f567"
    assert count(None) == "not known"


@pytest.mark.parametrize(
    ("areas", "area", "volume"),
    [
        ([2.8e-6, 1.1e-5, 3.3e-5], "11.0 ± 2.0 mm²", "+4.0 ± 2.0 mm³"),  # an ivory's chips and wear
        ([1.2e-4, 3.4e-5, 0.3], "0.110 ± 0.020 cm²", "+0.0040 ± 0.0020 cm³"),  # the middle one decides, not the odd one
        ([0.04, 2.5, 7.0], "0.000011 ± 0.000002 m²", "+0.000004 ± 0.000002 dm³"),  # a facade's units
        ([NAN, 0.02], "0.110 ± 0.020 cm²", "+0.0040 ± 0.0020 cm³"),
        ([], "0.110 ± 0.020 cm²", "+0.0040 ± 0.0020 cm³"),
    ],
)
def test_areas_and_volumes_are_told_in_the_units_of_the_middle_region(areas, area, volume):
    m = choose_measures(areas)
    assert estimate(1.1e-5, 1.02e-6, m.per_m2, m.area).text.replace("\u00a0", " ") == area
    assert estimate(4e-9, 1.02e-9, m.per_m3, m.volume, signed=True).text.replace("\u00a0", " ") == volume


def test_an_area_by_itself_is_told_in_its_own_unit():
    said = [square(a).replace("\u00a0", " ") for a in (4.2e-7, 0.0472, 1.0, NAN)]
    assert said == ["0.420 mm²", "472 cm²", "1.00 m²", "an area that is not known"]


def test_coordinates_have_the_decimals_that_the_size_of_the_object_asks_for():
    point = (0.00012, -0.02103, 4.5)
    assert coordinates(point, 0.0017) == "0.000, \u22120.021, 4.500"
    assert coordinates(point, 6e-5) == "0.00012, \u22120.02103, 4.50000"
    assert coordinates(point, 0.3) == "0.00, \u22120.02, 4.50"
    assert coordinates(point, 0.0) == "0.000120, \u22120.021030, 4.500000"


@pytest.mark.parametrize(("degrees", "text"), [
    (0.0, "north (0 degrees"), (90.0, "east (90 degrees"), (180.0, "south (180 degrees"), (270.0, "west (270 degrees"),
    (135.0, "south-east (135 degrees"), (100.25, "east (100.2 degrees"), (359.97, "north (0 degrees"),
])  # fmt: skip
def test_a_bearing_is_told_by_the_nearest_side_and_in_degrees(degrees, text):
    assert tell_bearing(math.radians(degrees)) == f"{text} clockwise from +y)"


def test_what_is_not_known_is_defined_in_one_place():
    """Each of four modules had a NAN of its own."""
    modules = Path(quantities.__file__).parent.glob("*.py")
    texts = {path.name: path.read_text(encoding="utf-8") for path in modules}
    assert [name for name, text in texts.items() if re.search(r"^(\w+, )*NAN(, \w+)* = ", text, re.MULTILINE)] == [
        "quantities.py"
    ]
