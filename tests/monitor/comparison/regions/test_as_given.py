"""A base that stood still in the coordinates as given, beside a front that was cleaned all over."""

import numpy as np
import pytest

from monitor.comparison import compare
from monitor.comparison.regions.as_given import doubt_as_given
from projects.model import Comparison, Floats, Registration, Surface
from projects.transforms import apply, invert

NOISE, LAYER = 2e-5, 6e-4  # m
STEP, ACROSS, UP = 0.002, 120, 90


def panel(rng: np.random.Generator, *, front: float = 0.0, base: float = 0.0) -> Surface:
    """Return a gently waved panel that looks along -y, its front and its base (a fifth of it) moved outwards."""
    x, z = (a.ravel() for a in np.meshgrid(STEP * np.arange(ACROSS), STEP * np.arange(UP)))
    is_base = z < 0.2 * STEP * UP
    out = 0.002 * np.sin(30.0 * x) * np.cos(25.0 * z) + np.where(is_base, base, front) + rng.normal(0, NOISE, len(x))
    k = np.arange(ACROSS * UP).reshape(UP, ACROSS)
    a, b, c, d = k[:-1, :-1].ravel(), k[:-1, 1:].ravel(), k[1:, :-1].ravel(), k[1:, 1:].ravel()
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([b, d, c])])
    return Surface(np.column_stack([x, -out, z]), faces, sigma=np.full(len(x), NOISE))


def compared(after: Surface, shift: Floats, frame: Floats) -> Comparison:
    """Return the comparison of the panel with a later one that lies in another frame, `shift` [m] off the first."""
    T, back = np.eye(4), np.eye(4)
    T[:3, 3], back[:3, 3] = shift, -frame
    before = panel(np.random.default_rng(1))
    moved = Surface(apply(invert(back), after.vertices), after.faces, sigma=after.sigma)
    known = Registration(T @ back, np.diag([1e-6] * 6) ** 2, np.array([0.12, 0.0, 0.09]), True, stable_share=0.8,
                         is_stable=np.ones(len(after.vertices), dtype=bool))  # fmt: skip
    return compare(before, moved, known)


@pytest.mark.parametrize(("side", "way"), [(-LAYER, "deeper"), (LAYER, "higher")])
def test_a_base_that_stood_still_in_the_coordinates_as_given_is_said(side: float, way: str) -> None:
    found = compared(panel(np.random.default_rng(2), front=side), np.array([0.0, side, 0.0]), np.zeros(3))
    (row,) = found.regions.itertuples()
    assert (row.kind, row.mean_m) == ("coated" if side < 0 else "cleaned", pytest.approx(-side, rel=0.05))
    doubt = doubt_as_given(found).registration.doubt
    assert doubt.startswith(
        "in the coordinates as given region 1 stood still, and the rest, which was taken to stand still, lies"
    )
    assert f" 0.60 mm {way}: if these coordinates hold" in doubt


def test_nothing_is_said_where_the_coordinates_agree_with_the_rest_or_with_nothing() -> None:
    coated = compared(panel(np.random.default_rng(2), base=LAYER), np.zeros(3), np.zeros(3))
    assert len(coated.regions) == 1
    assert doubt_as_given(coated).registration.doubt == ""
    elsewhere = compared(panel(np.random.default_rng(2), front=-LAYER), np.array([0.0, -LAYER, 0.0]),
                         np.array([0.1, -0.03, 0.02]))  # fmt: skip
    assert len(elsewhere.regions) == 1
    assert doubt_as_given(elsewhere).registration.doubt == ""


@pytest.mark.parametrize(("off", "is_said"), [(1.5e-4, True), (2.5e-4, False)])
def test_a_wide_base_that_nearly_stood_still_as_given_is_said(off: float, is_said: bool) -> None:
    """Coordinates that hold an object to 0.2 mm said nothing: 70 % of a panel that was coated was taken for still."""
    after = panel(np.random.default_rng(2), front=LAYER)
    doubt = doubt_as_given(compared(after, np.array([0.0, LAYER, 0.0]), np.array([0.0, off, 0.0]))).registration.doubt
    assert ("region 1 moved by no more than 0.15 mm, and the rest, which was taken to stand" in doubt) is is_said
