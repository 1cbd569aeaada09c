"""Where the brows of the terracotta relief are crossed, for how high they are."""

import numpy as np

from monitor.simulation.relief import BROW_WIDTH
from projects.model import Floats


def brow_profiles(n: int = 40) -> Floats:
    """Return places across both brows, (2 n, 3, 2): (u, v) [m] of the foot above, the crest and the foot below.

    The height of a brow is that of its crest above the mean of its feet, about 1.2 mm.
    """
    along = np.linspace(0.15, 0.85, n)
    turn = np.radians(58.0 * along - 22.0)
    width = BROW_WIDTH[0] + (BROW_WIDTH[1] - BROW_WIDTH[0]) * along
    r = 0.034 + np.stack([0.5 * width, 0.0 * width, -0.5 * width], axis=1)
    u, v = 0.017 + r * np.sin(turn)[:, None], 0.003 + r * np.cos(turn)[:, None]
    return np.concatenate([np.stack([u, v], axis=-1), np.stack([-u, v], axis=-1)])
