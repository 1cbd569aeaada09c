"""Which motions a shape holds: by the products of normals that err independently, in patches."""

import numpy as np
import pytest

from monitor.registration.motion.degeneracy import find_free_motion
from monitor.registration.motion.matching import Matches
from projects.model import Floats, Ints

N, N_PATCHES = 1200, 40
NOISE = 0.05  # rad, of normals


def pairs_of(slopes: Floats, rng: np.random.Generator) -> tuple[Matches, Ints]:
    """Return pairs on a square of 0.2 m whose true normals lean by `slopes` (n, 2), and their patches, in a grid."""
    xy = rng.uniform(-0.1, 0.1, (N, 2))
    points = np.column_stack([xy, np.zeros(N)])

    def seen() -> Floats:
        normals = np.column_stack([slopes + rng.normal(0.0, NOISE, (N, 2)), np.ones(N)])
        return np.asarray(normals / np.linalg.norm(normals, axis=1)[:, None])

    a, b, zero = seen(), seen(), np.zeros(N)
    patch = np.minimum((xy[:, 0] + 0.1) * 40, 7).astype(int) * 5 + np.minimum((xy[:, 1] + 0.1) * 25, 4).astype(int)
    return Matches(np.arange(N), points, zero, a, a, b, zero, zero, np.arange(N), zero, zero, zero, zero), patch


@pytest.mark.parametrize("seed", range(5))
def test_few_patches_that_all_hold_a_motion_hold_it_though_some_do_so_much_more(seed: int) -> None:
    """Their sum is not four times the root of the sum of their squares, which what they hold makes large itself."""
    rng = np.random.default_rng(seed)
    slopes = rng.choice([-0.15, 0.15], (N, 2))
    _, patch = pairs_of(slopes, np.random.default_rng(seed))
    edges = np.isin(patch, rng.choice(N_PATCHES, 3, replace=False))
    pairs, patch = pairs_of(np.where(edges[:, None], 12.0, 1.0) * slopes, np.random.default_rng(seed))
    assert find_free_motion(pairs, np.zeros(3), patch, by_sign=True) == ""


@pytest.mark.parametrize("seed", range(5))
def test_one_patch_of_many_that_says_most_does_not_silence_the_others(seed: int) -> None:
    """A plaque among whose bumps one rib held a turn as much as a third of the rest was refused: 3.5 sigmas, where the
    others alone are 20."""
    rng = np.random.default_rng(seed)
    slopes = rng.choice([-0.15, 0.15], (N, 2))
    pairs, _ = pairs_of(slopes, np.random.default_rng(seed))
    xy = pairs.points[:, :2] + 0.1
    patch = np.minimum(xy[:, 0] * 100, 19).astype(int) * 10 + np.minimum(xy[:, 1] * 50, 9).astype(int)
    patch[(patch >= 40) & (patch < 60)] = 40  # two rows of them are one
    steep = np.where(patch == 40, 12.0, 1.0)[:, None] * slopes
    pairs, _ = pairs_of(steep, np.random.default_rng(seed))
    assert find_free_motion(pairs, np.zeros(3), patch) == ""


@pytest.mark.parametrize("seed", range(20))
def test_noise_of_normals_holds_no_slide_of_a_plane(seed: int) -> None:
    pairs, patch = pairs_of(np.zeros((N, 2)), np.random.default_rng(seed))
    words = find_free_motion(pairs, np.zeros(3), patch, by_sign=True)
    assert (words.count("slide along"), words.count("turn about")) == (2, 1)  # three slides in one plane were told
