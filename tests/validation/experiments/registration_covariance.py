"""Is the true motion between two epochs where its covariance says that it is, and is it told where there is none?

Two epochs of a bumpy body 0.6 m wide, 4000 points each with 0.2 mm of noise of their own and 0.4 mm that neighbours
share over nothing, 10, 30 or 100 mm, up to a degree and some millimetres apart. And a wall of twenty pieces of 30 cm,
of which ever more moved by 2 mm and 5 mrad, each its own way, as bare clouds: what stayed is found where it is, or the
motion is refused or doubted.
"""

from __future__ import annotations

import numpy as np
from motion_errors import squared_error
from rows import Row, Size, judge
from scipy.stats import beta, chi2
from wall_of_pieces import move_pieces, scan_stove

from monitor.registration import register
from projects.model import Floats
from projects.transforms import apply

TITLE = "Two epochs: the true motion within the 95 % ellipsoid"
LIMIT = 3600.0
N_SIMULATED = {"small": 6, "full": 200}
FIRST_SEED = 10_400  # 0 to 399 chose how patches share errors; 10_000 to 10_399 showed what fell short before
REACHES = (None, 0.01, 0.03, 0.1)  # m, over which neighbouring points of an epoch err together
N_MOVED = {"small": (20,), "full": (6, 8, 10, 12, 13, 14, 20)}  # of twenty pieces
LIMIT_STAYED = 1e-4  # m, a third of the noise of a point
LOWEST, HIGHEST = 0.90, 0.99  # asked
NOTES = "In brackets the 95 % interval of Clopper and Pearson. The mean chi2 of an honest covariance is 6."


def run(size: Size) -> list[Row]:
    """Register pairs of epochs of many seeds, and walls of pieces."""
    return [*(epoch_row(reach, N_SIMULATED[size]) for reach in REACHES), *(piece_row(n) for n in N_MOVED[size])]


def epoch_row(reach: float | None, n: int) -> Row:
    """Return the share of two epochs of a bumpy body, with noise that neighbours share over `reach` [m]."""
    noise = "independent noise" if reach is None else f"noise shared over {1e3 * reach:.0f} mm"
    squared = np.array([squared_error(np.random.default_rng(FIRST_SEED + seed), reach) for seed in range(n)])
    return share_row(noise, squared, n)


def share_row(what: str, squared: Floats, n: int) -> Row:
    """Return the share within the 95 % ellipsoid, with the interval that n independent simulations give it."""
    share = float(np.mean(squared < chi2.ppf(0.95, 6)))
    low, high = beta.ppf(0.025, n * share, n * (1 - share) + 1), beta.ppf(0.975, n * share + 1, n * (1 - share))
    low, high = np.nan_to_num(low, nan=0.0), np.nan_to_num(high, nan=1.0)
    return Row(f"{what}: inside", f"{100 * share:.1f} % ({100 * low:.0f} to {100 * high:.0f})",
               judge(LOWEST <= share <= HIGHEST), asked="90 to 99 %", value=share,
               others={"mean chi2 of 6": f"{np.mean(squared):.1f}", "simulated": str(n)})  # fmt: skip


def piece_row(n_moved: int) -> Row:
    """Return how far what stayed of a wall of twenty pieces is off where some moved, or why it is not believed."""
    rng = np.random.default_rng(1)
    before, _ = scan_stove(rng)
    after, piece = scan_stove(rng)
    moved = np.random.default_rng(n_moved).permutation(20)[:n_moved]
    after, _ = move_pieces(after, piece, moved.tolist())
    found = register(after, before)
    stayed = after.points[~np.isin(piece, moved)]
    off = float(np.sqrt(np.mean(np.sum((apply(found.T_target_source, stayed) - stayed) ** 2, axis=1)))) if len(stayed) \
        else float("nan")  # fmt: skip
    told = "refused" if not found.converged else "doubted" if found.doubt else f"found, {1e3 * off:.2f} mm off"
    is_right = not found.converged or bool(found.doubt) or off < LIMIT_STAYED
    return Row(f"{n_moved} of 20 pieces moved, bare clouds: what stayed", told, judge(is_right),
               asked="within 0.1 mm, refused or doubted", value=off)  # fmt: skip
