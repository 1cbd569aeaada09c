"""Pictures that stand for those of a report, and what documents and pictures show."""

from io import BytesIO

import numpy as np
from pdf_oxide import PdfDocument
from PIL import Image

from reports.colours import LEFT_OUT, OUTSIDE, SET_ASIDE, STABLE
from reports.pictures import Pictures, Shown, ShownSingle, ShownView
from reports.views import Picture

BAR = Shown(b"<svg xmlns='http://www.w3.org/2000/svg' width='400' height='60'/>", "image/svg+xml", 0, 0, "a bar")
DOT = Shown(b"<svg xmlns='http://www.w3.org/2000/svg' width='40' height='30'/>", "image/svg+xml", 0, 0, "a dot")


def pictures_of(facts, difference=DOT):
    """Return dots for pictures, and one view whose difference is given."""
    regions = {r.number: (DOT, DOT) for r in facts.regions}
    views = (ShownView("Front", DOT, DOT, difference, 40.0, 30.0),)
    return Pictures(views, BAR, BAR, regions, stable=(ShownSingle("Front", DOT, 20.0),))


def text_of(document):
    """Return the text of all pages, white space as single spaces."""
    read = PdfDocument.from_bytes(document)
    return " ".join(" ".join(read.extract_text(k) for k in range(read.page_count())).replace("\u00a0", " ").split())


def share(picture: Picture, colour: tuple[int, int, int]) -> float:
    """Return the share of the object's pixels whose hue is that of `colour`, whatever light falls on them."""
    pixels = np.asarray(Image.open(BytesIO(picture.image))).reshape(-1, 3).astype(float)
    body = pixels[pixels.min(axis=1) < 250]
    hues = np.array([STABLE, SET_ASIDE, LEFT_OUT, OUTSIDE], dtype=float)
    hues /= hues.mean(axis=1, keepdims=True)
    nearest = np.argmin(np.abs(body[:, None] / body.mean(axis=1)[:, None, None] - hues).sum(axis=2), axis=1)
    grey = (STABLE, SET_ASIDE, LEFT_OUT, OUTSIDE).index(colour)
    return float(np.mean(np.isin(nearest, (2, 3) if grey >= 2 else (grey,))))
