"""What is written over a picture: the scale bar, and numbers in small circles with leader lines that do not collide.

Pictures go in as (height, width, 3) uint8 and come out so; drawing is done three times finer and averaged down.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy import ndimage

from projects.model import Bools, Floats, Ints
from reports.cameras import Frame
from reports.colours import RGB

FINER = 3
INK = (38, 40, 46, 255)
PAPER = (255, 255, 255, 255)
LEAST_SEEN = 6  # pixels of the picture that a region must show to be numbered in it
BAR_SHARE = 0.25  # of the longest side of the pictures at one scale, that the scale bar may reach
TEXT_WIDTH = 3.6  # of the height of its letters, that the bar's text takes with the gap before it


@dataclass(frozen=True)
class Label:
    """A number in a circle. `anchor` is the place it names, `centre` that of the circle, pixels x (right), y (down)."""

    number: int
    anchor: tuple[float, float]
    centre: tuple[float, float]


def text_height(frame: Frame) -> float:
    """Return the height of letters [pixels] for a frame: alike in all pictures at one scale, as wide as these allow."""
    return max(11.0, min(frame.letters or 0.024 * frame.longest, 0.11 * frame.width))


def bar_length(frame: Frame) -> float:
    """Return the length [m] of the scale bar: 1, 2 or 5 times a power of ten, with its text within the picture."""
    beside = 2.0 * bar_margin(frame) + TEXT_WIDTH * text_height(frame)
    room = max(min(BAR_SHARE * frame.longest, 0.55 * frame.width, frame.width - beside), 0.2 * frame.width)
    length = room * frame.metres_per_pixel
    power = 10.0 ** np.floor(np.log10(length))
    step = max(s for s in (1.0, 2.0, 5.0) if s * power <= length)
    return float(f"{step * power:.3g}")


def say_length(metres: float) -> str:
    """Return a round length in the unit that reads best: 2 m, 20 cm, 5 mm, 0.5 mm."""
    if metres >= 1.0:
        return f"{metres:g} m"
    if metres >= 0.01:
        return f"{metres * 100:g} cm"
    return f"{metres * 1000:g} mm"


def bar_margin(frame: Frame) -> float:
    """Return the pixels left of the scale bar."""
    return min(0.4 * frame.foot, 0.1 * frame.width)


def bar_place(frame: Frame) -> tuple[float, float, float, float]:
    """Return left, top, right, bottom [pixels] of the scale bar."""
    margin, length = bar_margin(frame), bar_length(frame) / frame.metres_per_pixel
    thick = max(4.0, 0.22 * text_height(frame))
    bottom = frame.height - 0.28 * frame.foot
    return margin, bottom - thick, margin + length, bottom


def seen_regions(numbers: Ints, n_least: int = LEAST_SEEN) -> list[int]:
    """Return the regions, rising, that fill at least `n_least` pixels of a map of region numbers (0: none)."""
    counts = np.bincount(numbers.ravel())
    return [k for k in range(1, len(counts)) if counts[k] >= n_least]


def find_anchor(numbers: Ints, number: int) -> tuple[float, float]:
    """Return the pixel (x, y) deepest inside the largest connected part of a region."""
    box = ndimage.find_objects((numbers == number).astype(np.int8))[0]
    parts, _ = ndimage.label(numbers[box] == number)
    largest = parts == np.bincount(parts.ravel())[1:].argmax() + 1
    depth = ndimage.distance_transform_edt(np.pad(largest, 1))[1:-1, 1:-1]
    middle = ndimage.center_of_mass(largest)
    y, x = np.indices(largest.shape)
    near = np.hypot(y - middle[0], x - middle[1])
    best = np.unravel_index(np.argmax(depth - 1e-3 * near), depth.shape)
    return float(best[1] + box[1].start) + 0.5, float(best[0] + box[0].start) + 0.5


def place_labels(numbers: Ints, shown: Bools, frame: Frame) -> list[Label]:
    """Return a label for each region of a map of region numbers (height, width), none on another.

    Each takes the cheapest free place around its anchor: off the changes, rather beside the object (`shown`) than on
    it, near, its leader line crossing no other line, circle or region. A label that finds no place is left out.
    """
    radius = label_radius(frame)
    covers = ndimage.uniform_filter((numbers > 0).astype(np.float32), max(1, round(2 * radius)))
    hides = ndimage.uniform_filter(shown.astype(np.float32), max(1, round(2 * radius)))
    anchors = {k: find_anchor(numbers, k) for k in seen_regions(numbers)}
    placed: list[Label] = []
    for number, anchor in anchors.items():
        others = [a for k, a in anchors.items() if k != number]
        options = _places_around(anchor, radius, frame)
        costs = [_cost(number, anchor, c, radius, (numbers, covers, hides), placed, others) for c in options]
        if costs and np.isfinite(min(costs)):
            placed.append(Label(number, anchor, options[int(np.argmin(costs))]))
    return placed


def label_radius(frame: Frame) -> float:
    """Return the radius [pixels] of a label's circle."""
    return 0.92 * text_height(frame)


def _places_around(anchor: tuple[float, float], radius: float, frame: Frame) -> list[tuple[float, float]]:
    """Return the places around an anchor whose circle lies within the picture, above the scale bar, nearest first."""
    angles = np.radians(np.arange(0, 360, 15) + 52.5)
    places = [(anchor[0] + r * radius * np.cos(a), anchor[1] - r * radius * np.sin(a))
              for r in (2.2, 2.9, 3.7, 4.7, 6.0, 7.6, 9.5, 12.0) for a in angles]  # fmt: skip
    edge = radius + 2
    lowest = frame.height - max(0.6 * frame.foot, 0) - edge
    return [(x, y) for x, y in places if edge <= x <= frame.width - edge and edge <= y <= lowest]


def _cost(
    number: int,
    anchor: tuple[float, float],
    centre: tuple[float, float],
    radius: float,
    maps: tuple[Ints, Floats, Floats],
    placed: list[Label],
    others: list[tuple[float, float]],
) -> float:
    """Return how bad a place is; infinite where circles would touch or a leader line runs through a circle."""
    numbers, covers, hides = maps
    for label in placed:
        apart = np.hypot(label.centre[0] - centre[0], label.centre[1] - centre[1])
        blocked = _distance(label.centre, anchor, centre) < 1.2 * radius
        if apart < 2.3 * radius or blocked or _distance(centre, label.anchor, label.centre) < 1.2 * radius:
            return float("inf")
    if any(np.hypot(a[0] - centre[0], a[1] - centre[1]) < 1.3 * radius for a in others):
        return float("inf")
    crossings = sum(_cross(anchor, centre, label.anchor, label.centre) for label in placed)
    row, column = int(centre[1]), int(centre[0])
    share = np.linspace(0.0, 1.0, 40)
    along = numbers[(anchor[1] + share * (centre[1] - anchor[1])).astype(int),
                    (anchor[0] + share * (centre[0] - anchor[0])).astype(int)]  # fmt: skip
    through = float(((along > 0) & (along != number)).mean())
    length = np.hypot(centre[0] - anchor[0], centre[1] - anchor[1]) / radius
    return float(0.35 * length + 9.0 * covers[row, column] + 1.2 * hides[row, column] + 8.0 * crossings + 6.0 * through)


def _distance(point: tuple[float, float], a: tuple[float, float], b: tuple[float, float]) -> float:
    """Return the distance of a point from the line between two others."""
    p, start, end = (np.array(v) for v in (point, a, b))
    length2 = float((end - start) @ (end - start))
    t = np.clip((p - start) @ (end - start) / length2, 0.0, 1.0) if length2 > 0 else 0.0
    return float(np.linalg.norm(p - start - t * (end - start)))


def _cross(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float], d: tuple[float, float]) -> bool:
    """Whether the line from a to b crosses that from c to d."""

    def side(p: tuple[float, float], q: tuple[float, float], r: tuple[float, float]) -> float:
        """Return on which side of the line from p to q the point r lies, by sign."""
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

    return side(a, b, c) * side(a, b, d) < 0 and side(c, d, a) * side(c, d, b) < 0


def annotate(picture: RGB, frame: Frame, labels: list[Label], section: Floats | None = None) -> RGB:
    """Return the picture with its scale bar, its labels, and marks A and B where a section is cut.

    `section` (2, 2, 2): for either end of the section a line from outside in, pixels x and y.
    """
    size = (picture.shape[1] * FINER, picture.shape[0] * FINER)
    sheet = Image.new("RGBA", size, (255, 255, 255, 0))
    pen = ImageDraw.Draw(sheet)
    _draw_bar(pen, frame)
    if section is not None:
        _draw_section(pen, section, frame)
    for label in labels:
        _draw_leader(pen, label, frame)
    for label in labels:
        _draw_circle(pen, label, frame)
    return _lay_over(picture, np.asarray(sheet))


def _lay_over(picture: RGB, sheet: RGB) -> RGB:
    """Return the picture under a finer sheet (red, green, blue, opacity), averaged down by opacity."""
    opacity = np.zeros((*picture.shape[:2], 1), dtype=np.float32)
    ink = np.zeros(picture.shape, dtype=np.float32)
    for part in (sheet[i::FINER, j::FINER] for i in range(FINER) for j in range(FINER)):
        share = part[..., 3:] * np.float32(1 / 255 / FINER**2)
        opacity += share
        ink += part[..., :3] * share
    return np.rint(picture * (1.0 - opacity) + ink).astype(np.uint8)


@functools.cache
def load_font(size: int) -> ImageFont.FreeTypeFont:
    """Return the sans font (DejaVu, which comes with matplotlib) in a size of pixels."""
    return ImageFont.truetype(str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"), size)


def _draw_bar(pen: ImageDraw.ImageDraw, frame: Frame) -> None:
    """Draw the scale bar, its halves dark and light, with its length beside it."""
    left, top, right, bottom = (FINER * v for v in bar_place(frame))
    line = max(2, round(FINER * 1.1))
    pen.rectangle((left, top, right, bottom), fill=PAPER, outline=INK, width=line)
    n_parts = 4 if f"{bar_length(frame):e}".startswith("2") else 5
    edges = np.linspace(left, right, n_parts + 1)
    for k in range(0, n_parts, 2):
        pen.rectangle((edges[k], top, edges[k + 1], bottom), fill=INK)
    font = load_font(round(FINER * text_height(frame)))
    gap = 0.45 * FINER * text_height(frame)
    pen.text((right + gap, (top + bottom) / 2), say_length(bar_length(frame)), fill=INK, font=font, anchor="lm")


def _draw_section(pen: ImageDraw.ImageDraw, section: Floats, frame: Frame) -> None:
    """Draw where a section is cut: a line up to the region from either side, with a letter at its outer end."""
    size = text_height(frame)
    font, thin = load_font(round(FINER * size)), 0.075 * size * FINER
    for letter, line in zip("AB", section, strict=True):
        outer, inner = line
        length = max(float(np.hypot(*(inner - outer))), 1e-9)
        place = outer + (outer - inner) / length * 0.8 * size
        place = np.clip(place, 0.8 * size, [frame.width - 0.8 * size, frame.height - frame.foot - 0.8 * size])
        start = place + (inner - place) / max(float(np.hypot(*(inner - place))), 1e-9) * 0.85 * size
        ends = [tuple(FINER * start), tuple(FINER * inner)]
        pen.line(ends, fill=(255, 255, 255, 210), width=round(3 * thin))
        pen.line(ends, fill=INK, width=max(2, round(thin)))
        pen.text(tuple(FINER * place), letter, fill=INK, font=font, anchor="mm",
                 stroke_width=round(0.12 * FINER * size), stroke_fill=(255, 255, 255, 220))  # fmt: skip


def _draw_leader(pen: ImageDraw.ImageDraw, label: Label, frame: Frame) -> None:
    """Draw the line from a label to its place, with a dot there, on a pale edge that parts it from any ground."""
    ends = [(FINER * x, FINER * y) for x, y in (label.anchor, label.centre)]
    thin, dot = 0.065 * text_height(frame) * FINER, 0.12 * text_height(frame) * FINER
    x, y = ends[0]
    pen.line(ends, fill=(255, 255, 255, 200), width=round(3 * thin))
    pen.ellipse((x - dot - thin, y - dot - thin, x + dot + thin, y + dot + thin), fill=(255, 255, 255, 230))
    pen.line(ends, fill=INK, width=max(2, round(thin)))
    pen.ellipse((x - dot, y - dot, x + dot, y + dot), fill=INK)


def _draw_circle(pen: ImageDraw.ImageDraw, label: Label, frame: Frame) -> None:
    """Draw the number in its circle."""
    x, y, r = FINER * label.centre[0], FINER * label.centre[1], FINER * label_radius(frame)
    pen.ellipse((x - r, y - r, x + r, y + r), fill=PAPER, outline=INK, width=max(3, round(0.08 * r)))
    digits = str(label.number)
    font = load_font(round(FINER * text_height(frame) * (1.0 if len(digits) < 3 else 0.72)))
    pen.text((x, y), digits, fill=INK, font=font, anchor="mm")
