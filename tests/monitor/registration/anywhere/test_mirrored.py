"""Epochs of which one is a mirror image: named, whether they are refused or laid onto each other askew."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from monitor.registration.anywhere.mirrored import mirror, say_mirrored
from monitor.registration.epochs import register_epochs
from projects.model import PointCloud, Surface
from projects.transforms import apply

WORDS = "the mirror image of the compared epoch fits the reference"
T = np.array([[0.0, -1.0, 0.0, 2.0], [0.0, 0.0, -1.0, 1.0], [1.0, 0.0, 0.0, -3.0], [0.0, 0.0, 0.0, 1.0]])


def bust(rng: np.random.Generator, one_sided: float) -> Surface:
    """Return a ball with bumps that are the more one-sided the more is asked for, with 0.1 mm of noise."""
    ball = trimesh.creation.icosphere(5, 0.5)
    x, y, z = np.array(ball.vertices).T
    height = 0.05 * np.sin(7.0 * y + 2.0) + 0.06 * np.cos(5.0 * z + 1.0 + 6.0 * one_sided * x)
    vertices = np.array(ball.vertices) * (1.0 + height + one_sided * 0.15 * np.sin(6.0 * x + 3.0 * y))[:, None]
    return Surface(vertices + rng.normal(0.0, 1e-4, vertices.shape), np.array(ball.faces))


def moved(surface: Surface) -> Surface:
    """Return the surface elsewhere."""
    return Surface(apply(T, surface.vertices), surface.faces)


@pytest.mark.parametrize(("one_sided", "is_moved"), [(1.0, False), (1.0, True), (0.1, False)])
def test_an_epoch_with_an_axis_the_other_way_is_named(
    rng: np.random.Generator, one_sided: float, is_moved: bool
) -> None:
    """Bumps of 13 mm on one side are enough, where scans have 0.1 mm of noise."""
    image = mirror(bust(rng, one_sided))
    assert isinstance(image, Surface)
    found, _ = register_epochs(moved(image) if is_moved else image, bust(rng, one_sided))
    assert (found.doubt if found.converged else found.reason).startswith(WORDS)


def test_an_epoch_that_was_moved_is_not_called_mirrored(rng: np.random.Generator) -> None:
    found, _ = register_epochs(moved(bust(rng, 1.0)), bust(rng, 1.0))
    assert found.converged
    assert found.T_target_source @ T == pytest.approx(np.eye(4), abs=2e-4)
    assert WORDS not in found.doubt + found.reason


def test_a_doubtful_epoch_that_fits_no_better_as_its_mirror_image_is_not_called_mirrored(
    rng: np.random.Generator,
) -> None:
    before = bust(rng, 1.0)
    turned = before.vertices * np.where(before.vertices[:, 1:2] > 0.1, [1.0, 1.04, 0.97], 1.0)  # not as a whole
    found, _ = register_epochs(Surface(turned + rng.normal(0.0, 1e-4, turned.shape), before.faces), before)
    assert WORDS not in found.doubt + found.reason
    doubtful = replace(found, doubt=found.doubt or "two thirds moved")
    assert say_mirrored(moved(before), before, doubtful) == ""


def test_a_layer_is_told_in_its_own_words(rng: np.random.Generator) -> None:
    image, before = mirror(bust(rng, 1.0)), bust(rng, 1.0)
    assert isinstance(image, Surface)
    found, _ = register_epochs(image, before)
    assert say_mirrored(image, before, found).startswith(WORDS)
    assert say_mirrored(image, before, replace(found, layer=1e-3)) == ""
    assert say_mirrored(image, before, replace(found, doubt="")) == ""


def test_a_mirror_image_looks_outward_and_is_one_with_its_scanner(rng: np.random.Generator) -> None:
    surface = bust(rng, 1.0)
    image = mirror(surface)
    assert isinstance(image, Surface)
    volumes = [trimesh.Trimesh(s.vertices, s.faces, process=False).volume for s in (surface, image)]
    assert volumes[0] > 0.1
    assert volumes[1] == pytest.approx(volumes[0])
    cloud = PointCloud(
        np.array([[1.0, 2.0, 3.0]]), normals=np.array([[1.0, 0.0, 0.0]]), origins=np.array([4.0, 5.0, 6.0])
    )
    twin = mirror(cloud)
    assert isinstance(twin, PointCloud)
    assert twin.points.tolist() == [[-1.0, 2.0, 3.0]]
    assert twin.normals is not None
    assert twin.normals.tolist() == [[-1.0, 0.0, 0.0]]
    assert np.asarray(twin.origins).tolist() == [-4.0, 5.0, 6.0]
