"""What the errors of unchanged pairs go with: which of the terms that a level of detection is made of foretell them.

    PYTHONPATH=$PWD:tests/validation:tests/validation/experiments python tests/validation/error_terms.py FIRST END STEP

Pairs as of the experiment `no_change_pairs`, by their seeds. Errors are the distances of the compared surface's
assessed vertices, over their 68 % quantile in the pair; so are the terms that they are held against.
"""

from __future__ import annotations

import itertools
import sys
import tempfile
from pathlib import Path

import no_change_pairs
import numpy as np
from held_out import measure_again
from scipy.spatial.transform import Rotation

from projects import Project
from projects.model import Comparison, Floats

BOUNDS = {
    "sigma of the surfaces": (0.0, 0.4, 0.6, 0.8, 1.0, 1.3, 1.7, 2.5, np.inf),
    "sigma shared": (0.0, 1.0, 2.0, 3.0, 5.0, np.inf),
    "cosine of the best view": (0.0, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0),
    "third of the lever arm": (0.0, 1.0, 2.0, 3.0),
}
Stations = list[list[tuple[Floats, Floats]]]


def measure_pair(seed: int) -> tuple[Floats, Floats]:
    """Return error, whether it is beyond lod95, and terms (n, 6) of a pair's vertices, and its registration's chi2."""
    rng = np.random.default_rng([seed, 1])
    instrument = no_change_pairs.INSTRUMENT_NAMES[seed % len(no_change_pairs.INSTRUMENT_NAMES)]
    spacing, scene = rng.uniform(0.003, 0.0045), no_change_pairs.make_body(seed)
    drawn = np.random.default_rng([seed, 1])
    drawn.uniform()
    stations = [no_change_pairs.spread_stations(drawn) for _ in range(2)]  # the same that `scan_epoch` draws
    epochs = [no_change_pairs.scan_epoch(scene, 2 * seed + k, rng, instrument, spacing) for k in range(2)]
    with tempfile.TemporaryDirectory() as folder:
        comparison, _ = no_change_pairs.compare_pair(epochs, Path(folder))
        project = Project.open(Path(folder) / "project")
        moved = [project.get("body", f"e{k}", "network")["T_project_given"] for k in range(2)]
        return terms_of(comparison, stations), registration_chi2(comparison, stations, moved)


def terms_of(comparison: Comparison, stations: Stations) -> Floats:
    """Return error, whether it is beyond lod95, and the terms in the order of `BOUNDS`, of each assessed vertex."""
    side = measure_again(comparison)[1]
    here = np.flatnonzero(side.is_assessed)
    size = np.quantile(np.abs(side.distances[here]), 0.6827)
    points, normals = side.surface.vertices[here], side.normals[here]
    views = []
    for poses in stations:
        ways = np.array([true[:3, 3] for true, _ in poses])[:, None] - points
        views.append((np.einsum("snk,nk->sn", ways, normals) / np.linalg.norm(ways, axis=2)).max(axis=0))
    arm = np.linalg.norm(points - comparison.registration.centre, axis=1)
    third = np.digitize(arm, np.quantile(arm, [1.0 / 3.0, 2.0 / 3.0]))
    error = np.abs(side.distances[here])
    is_beyond = error > comparison.on_compared.lod95[here]
    seen = np.clip(np.min(views, axis=0), 0.0, 0.999)
    stated = [side.sigma_surfaces[here] / size, side.sigma_shared[here] / size]
    return np.column_stack([error / size, is_beyond, *stated, seen, third])


def registration_chi2(comparison: Comparison, stations: Stations, moved: list[Floats]) -> Floats:
    """Return chi2 of the registration's error: of all six, of the rotation, of the translation.

    The frame of an epoch is the mean of where its adjustment put the stations, against where they truly stood.
    """
    registration = comparison.registration
    centre, frames = registration.centre, []
    for poses, motions in zip(stations, moved, strict=True):
        off = [T @ given @ np.linalg.inv(true) for T, (true, given) in zip(motions, poses, strict=True)]
        frames.append(as_matrix(np.mean([about(T, centre) for T in off], axis=0), centre))
    error = about(registration.T_target_source @ frames[1] @ np.linalg.inv(frames[0]), centre)
    parts = (slice(0, 6), slice(0, 3), slice(3, 6))
    return np.array([error[p] @ np.linalg.solve(registration.covariance[p, p], error[p]) for p in parts])


def about(T: Floats, centre: Floats) -> Floats:
    """Return rotation [rad] and translation [m] (6,) of a motion about a centre."""
    return np.concatenate([Rotation.from_matrix(T[:3, :3]).as_rotvec(), T[:3, :3] @ centre + T[:3, 3] - centre])


def as_matrix(motion: Floats, centre: Floats) -> Floats:
    """Return the matrix (4, 4) of a motion about a centre."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(motion[:3]).as_matrix()
    T[:3, 3] = centre + motion[3:] - T[:3, :3] @ centre
    return T


def main() -> None:
    """Print how large errors are, and how many lie beyond their level, by each term."""
    pairs = [measure_pair(seed) for seed in range(*(int(a) for a in sys.argv[1:4]))]
    terms, chi2 = np.vstack([t for t, _ in pairs]), np.mean([c for _, c in pairs], axis=0)
    print(f"{len(pairs)} pairs; chi2 of the registration {chi2[0]:.1f} of 6, rotation {chi2[1]:.1f} and translation "
          f"{chi2[2]:.1f} of 3 each")  # fmt: skip
    for column, (name, bounds) in enumerate(BOUNDS.items(), 2):
        print(f"by {name}: 68 % of errors below, 95 % over 1.96, beyond lod95, share of vertices")
        for low, high in itertools.pairwise(bounds):
            here = terms[(terms[:, column] >= low) & (terms[:, column] < high)]
            if len(here):
                inner, outer = np.quantile(here[:, 0], [0.6827, 0.95])
                beyond, share = 100.0 * here[:, 1].mean(), 100.0 * len(here) / len(terms)
                print(f"  {low:.1f} to {high:.1f}: {inner:.2f}, {outer / 1.96:.2f}, {beyond:.1f} %, {share:.1f} %")


if __name__ == "__main__":
    main()
