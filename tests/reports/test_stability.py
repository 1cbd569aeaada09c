"""The picture of what held two epochs together: green where stable, sand where changed, pale where nobody asked."""

from dataclasses import replace

import numpy as np
from report_examples import example_comparison
from shown_examples import share

from projects.extent import Extent
from projects.model import Assessment, Comparison
from reports.colours import LEFT_OUT, OUTSIDE, SET_ASIDE, STABLE
from reports.stability import draw_stable


def held(is_stable: np.ndarray | None) -> Comparison:
    comparison = example_comparison()
    return replace(comparison, registration=replace(comparison.registration, is_stable=is_stable))


def test_all_is_green_but_what_changed() -> None:
    comparison = example_comparison()
    n = len(comparison.on_compared.surface.vertices)
    drawn = draw_stable(held(np.ones(n, dtype=bool)))
    assert 1 <= len(drawn) <= 4
    changed = float(np.mean(comparison.on_compared.assessment == Assessment.CHANGED))
    greens, sands = (np.array([share(p, c) for _, p in drawn]) for c in (STABLE, SET_ASIDE))
    assert greens.mean() > 0.6
    assert sands.max() > 0.5 * changed
    assert greens.max() > sands.max()


def test_what_changed_with_the_whole_alone_is_green() -> None:
    """A ball whose whole motion was left in the differences: 97.5 % of it held stable, and drawn as changed."""
    comparison = example_comparison()
    moved = replace(held(np.ones(len(comparison.on_compared.surface.vertices), dtype=bool)), mode="absolute")
    assert max(share(p, SET_ASIDE) for _, p in draw_stable(moved)) == 0.0


def test_what_follows_no_motion_and_what_was_not_asked_is_grey() -> None:
    vertices = example_comparison().on_compared.surface.vertices
    low = vertices[:, 2] < np.median(vertices[:, 2])
    partly = draw_stable(held(low))
    assert 0.25 < np.mean([share(p, LEFT_OUT) for _, p in partly]) < 0.75
    middle = float(np.median(vertices[:, 2]))
    corners = np.array([[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0]])
    given = draw_stable(held(np.ones(len(vertices), dtype=bool)), Extent(corners, top=middle))
    assert 0.25 < np.mean([share(p, OUTSIDE) for _, p in given]) < 0.75


def test_without_stable_areas_there_is_no_picture() -> None:
    assert draw_stable(held(None)) == []


def test_stable_areas_are_seen_from_the_front_that_was_given() -> None:
    n = len(example_comparison().on_compared.surface.vertices)
    view = draw_stable(held(np.ones(n, dtype=bool)), bearing=np.pi / 2)[0][0]
    assert view.name == "front"
    np.testing.assert_allclose(view.towards, [1.0, 0.0, 0.0], atol=1e-11)
