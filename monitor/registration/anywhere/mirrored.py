"""Epochs of which one is the mirror image of the other: an axis points the other way in its file, or two are exchanged.

In: the surfaces or clouds of both epochs, and the motion that was found. Out: words that name it, where the mirror
image of one fits the other to its noise, and itself does not. No motion turns a left hand into a right one: such epochs
are refused, or laid onto each other askew, and hardly anything else tells what is wrong with them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from monitor.registration.anywhere.coarse import register_from_anywhere
from projects.errors import MonitorError
from projects.model import PointCloud, Registration, Surface

MIRROR = np.array([-1.0, 1.0, 1.0])
MOSTLY = 0.5  # of the samples have a partner: the mirror image lies on the reference


def say_mirrored(compared: Surface | PointCloud, reference: Surface | PointCloud, found: Registration) -> str:
    """Return that the mirror image of the compared epoch fits the reference, where the epoch itself was `found` to fit
    it badly or not at all; "" where its mirror image does not, or where nothing speaks against what was found.

    What is its own mirror image fits as well itself. A layer, another scale and what changed on most of an object are
    told in words of their own.
    """
    is_told = np.isfinite(found.layer) or np.isfinite(found.scale) or found.stable_is_rest
    if found.converged and (is_told or not found.doubt):
        return ""
    try:
        image, _ = register_from_anywhere(mirror(compared), reference)
    except MonitorError:
        return ""
    if not image.converged or image.doubt or image.overlap < MOSTLY:
        return ""
    return (
        "the mirror image of the compared epoch fits the reference, as it does not itself: does an axis point the "
        "other way in one of the files, or are two exchanged?"
    )


def mirror(noun: Surface | PointCloud) -> Surface | PointCloud:
    """Return the mirror image of a surface or cloud, its x axis pointing the other way; its normals and faces look
    outward if they did."""
    normals = None if noun.normals is None else noun.normals * MIRROR
    if isinstance(noun, Surface):
        return replace(noun, vertices=noun.vertices * MIRROR, faces=noun.faces[:, ::-1], normals=normals)
    origins = None if noun.origins is None else noun.origins * MIRROR
    return replace(noun, points=noun.points * MIRROR, normals=normals, origins=origins)
