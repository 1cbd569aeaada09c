"""Numbers as a reader wants them: rounded by their uncertainty, with a unit, and "not known" where they are NaN.

The one place where metres and radians become millimetres, square centimetres and degrees. A margin is always the
half-width of the 95 % interval. Spaces inside a quantity do not break. Areas and volumes of one report are told in the
units in which its regions read best: a medal's in square millimetres, a facade's in square metres.
"""

from __future__ import annotations

import datetime
import math
import statistics
from collections.abc import Iterable
from dataclasses import dataclass

from projects.model import Z95

NOT_KNOWN, NAN = "not known", math.nan  # in words, and as the number
MM, DEGREES = 1e3, 180.0 / math.pi  # of one m, rad
NBSP, THIN, MINUS = "\u00a0", "\u202f", "\u2212"
NO_SHARE = 1e-11  # of anything: what sums of shares round to
FINEST = 6  # no more decimals than these, however small the margin
MONTHS = ("January", "February", "March", "April", "May", "June", "July", "August", "September", "October",
          "November", "December")  # fmt: skip
SIDES_OF_THE_WORLD = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")
WORDS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % margin, both printed: "\u221212.4" and "0.3"; the margin is empty where there is none.

    Of a size that is hardly known, "about 20", `most` is what it may be at most, and stands in the place of the margin.
    """

    value: str
    margin: str = ""
    unit: str = ""
    most: str = ""

    @property
    def is_words(self) -> bool:
        """Whether it is no number, but words that stand for one."""
        return not self.unit

    @property
    def beside(self) -> str:
        """The margin as it stands beside the value, in a column of its own."""
        if self.most:
            return f"up to{NBSP}{self.most}"
        return f"margin {NOT_KNOWN}" if self.margin == NOT_KNOWN else f"±{NBSP}{self.margin}" if self.margin else ""

    @property
    def text(self) -> str:
        """The whole: value, margin and unit; a degree sign stands at each number."""
        if self.margin == NOT_KNOWN:
            return f"{Estimate(self.value, unit=self.unit).text} ({self.beside})"
        if self.unit == "°" and self.value != NOT_KNOWN:
            return f"{self.value}°" + (f"{NBSP}±{NBSP}{self.margin}°" if self.margin else "")
        if self.most:
            return f"{Estimate(self.value, unit=self.unit).text} (not well known, {self.beside}{NBSP}{self.unit})"
        parts = [self.value, self.beside, self.unit]
        return NBSP.join(p for p in parts if p) if self.value != NOT_KNOWN else NOT_KNOWN


@dataclass(frozen=True)
class Measures:
    """The units that areas and volumes are told in: their names, and how many make one m2 and one m3."""

    area: str
    volume: str
    per_m2: float
    per_m3: float


FINE = Measures("mm²", "mm³", 1e6, 1e9)
USUAL = Measures("cm²", "cm³", 1e4, 1e6)
WIDE = Measures("m²", "dm³", 1.0, 1e3)  # a millimetre off a square metre is a cubic decimetre


def choose_measures(areas: Iterable[float]) -> Measures:
    """Return the units for regions of these areas [m2]: those in which the middle one reads best, mm2 below 1 cm2, m2
    from 1 m2 on; one choice for all, so that rows of a table compare."""
    known = [a for a in areas if math.isfinite(a)]
    middle = statistics.median(known) if known else math.nan
    return FINE if middle < 1e-4 else WIDE if middle >= 1.0 else USUAL


def square(area: float) -> str:
    """Return an area [m2] without a margin, in the unit in which it reads best."""
    if not math.isfinite(area):
        return "an area that is not known"
    measures = choose_measures([area])
    return plain(area, measures.per_m2, measures.area, digits=3)


def coordinates(point: Iterable[float], fineness: float) -> str:
    """Return coordinates [m] with the decimals that show `fineness` [m], two at least."""
    decimals = min(max(math.ceil(-math.log10(fineness)), 2), FINEST) if fineness > 0.0 else FINEST
    return ", ".join(print_number(float(v), decimals) for v in point)


def count_decimals(margin: float) -> int:
    """Return how many decimals a number with this margin deserves: two digits of a margin that begins with 1 or 2,
    one of others; negative where tens are rounded."""
    exponent = math.floor(math.log10(margin))
    leading = round(margin / 10.0**exponent, 1)
    return min((1 if leading < 3.0 else 0) - exponent, FINEST)


def print_number(value: float, decimals: int, *, signed: bool = False) -> str:
    """Return a number with so many decimals, thousands apart, a true minus, and a plus where it is `signed`."""
    rounded = round(value, decimals) + 0.0  # no minus before zero
    text = f"{abs(rounded):,.{max(decimals, 0)}f}".replace(",", THIN)
    sign = MINUS if rounded < 0 else "+" if signed and rounded > 0 else ""
    return sign + text


def estimate(value: float, sigma: float, scale: float, unit: str, *, signed: bool = False) -> Estimate:
    """Return `value` (one sigma `sigma`) times `scale` as printed, rounded by its 95 % margin; two digits where that is
    not known, three where there is none."""
    if not math.isfinite(value):
        return Estimate(NOT_KNOWN)
    margin = Z95 * sigma * scale
    if not math.isfinite(margin) or margin <= 0.0:
        unknown, digits = ("", 3) if margin == 0.0 else (NOT_KNOWN, 2)
        return Estimate(print_number(value * scale, significant(value * scale, digits), signed=signed), unknown, unit)
    decimals = count_decimals(margin)
    told = print_number(margin, decimals)
    if round(margin, decimals) == 0.0:  # a margin is never told as none
        told = f"<{NBSP}{print_number(10.0**-decimals, decimals)}"
    return Estimate(print_number(value * scale, decimals, signed=signed), told, unit)


def estimate_size(value: float, sigma: float, scale: float, unit: str) -> Estimate:
    """Return an `estimate` of what cannot be below zero, an area: where its margin is as large as itself, about how
    large it is, with one digit, and how large at most."""
    margin = Z95 * sigma
    if not (math.isfinite(value) and math.isfinite(margin) and margin >= value > 0.0):
        return estimate(value, sigma, scale, unit)
    about, most = value * scale, (value + margin) * scale
    step = 10.0 ** -(leading(most) + 1)
    told = print_number(math.ceil(most / step - 1e-9) * step, leading(most) + 1)
    return Estimate(f"about{NBSP}{print_number(about, leading(about))}", "", unit, told)


def leading(value: float) -> int:
    """Return the decimals that show one digit of a number (> 0), negative where tens are rounded."""
    return min(-math.floor(math.log10(value)), FINEST)


def about_square(area: float, sigma: float) -> str:
    """Return an area [m2] in words, with the digits that its margin leaves, and whether it is hardly known."""
    measures = choose_measures([area])
    size, margin = area * measures.per_m2, Z95 * sigma * measures.per_m2
    if not (math.isfinite(size) and math.isfinite(margin) and size > 0.0 and margin > 0.0):
        return square(area)
    if margin >= size:
        return f"about{NBSP}{print_number(size, leading(size))}{NBSP}{measures.area}, which is not well known"
    decimals = min(max(leading(margin), leading(size)), leading(size) + 2)
    return f"about{NBSP}{print_number(size, decimals)}{NBSP}{measures.area}"


def significant(value: float, digits: int = 3) -> int:
    """Return the decimals that show so many digits of a number."""
    if value == 0.0 or not math.isfinite(value):
        return 0
    return max(min(digits - 1 - math.floor(math.log10(abs(value))), FINEST), 0)


def plain(value: float, scale: float, unit: str, *, signed: bool = False, digits: int = 2) -> str:
    """Return a number without a margin, with so many digits."""
    if not math.isfinite(value):
        return NOT_KNOWN
    text = print_number(value * scale, significant(value * scale, digits), signed=signed)
    return f"{text}{NBSP}{unit}" if unit else text


def millimetres(value: float, *, signed: bool = False) -> str:
    """Return a length [m] in millimetres, two digits."""
    return plain(value, MM, "mm", signed=signed)


def percent(share: float) -> str:
    """Return a share of 0 to 1 in per cent, with more decimals the nearer it is to none or all."""
    if not math.isfinite(share):
        return NOT_KNOWN
    share = 0.0 if abs(share) < NO_SHARE else 1.0 if abs(share - 1.0) < NO_SHARE else share  # rounding of sums
    rest = min(share, 1.0 - share)
    if rest <= 0.0:
        return f"{100.0 * share:.0f}{NBSP}%"
    if rest < 1e-4:
        return f"<{NBSP}0.01{NBSP}%" if share < 0.5 else f">{NBSP}99.99{NBSP}%"
    decimals = 0 if rest >= 0.0995 else 1 if rest >= 0.00995 else 2
    return f"{100.0 * share:.{decimals}f}{NBSP}%"


def count(n: int | float | None) -> str:
    """Return a number of things, thousands apart."""
    return NOT_KNOWN if n is None or not math.isfinite(n) else f"{int(n):,}".replace(",", THIN)


def in_words(n: int) -> str:
    """Return a number of things as a word up to twelve, in digits beyond."""
    return WORDS[n] if n < len(WORDS) else count(n)


def height(value: float) -> str:
    """Return a length [m] as one says where something is: centimetres, millimetres below ten of them, metres above."""
    if not math.isfinite(value):
        return NOT_KNOWN
    if abs(value) < 0.0995:
        return f"{print_number(value * 1e3, 0)}{NBSP}mm"
    if abs(value) < 0.995:
        return f"{print_number(value * 1e2, 0)}{NBSP}cm"
    return f"{print_number(value, 2)}{NBSP}m"


def tell_bearing(bearing: float) -> str:
    """Return to which side of the world a bearing [rad], clockwise from +y, goes, in words and degrees."""
    degrees = round(bearing * DEGREES, 1) % 360.0
    return f"{SIDES_OF_THE_WORLD[round(degrees / 45.0) % 8]} ({degrees:g} degrees clockwise from +y)"


def day(date: datetime.date) -> str:
    """Return a date in words, whatever the machine's language."""
    return f"{date.day}{NBSP}{MONTHS[date.month - 1]}{NBSP}{date.year}"


def listed(parts: list[str]) -> str:
    """Return parts as a list in words: "a, b and c"."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}" if parts else ""
