"""Is the stated sigma of a volume true? 200 simulated pairs of surfaces with correlated noise and an unknown motion."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh
from bumpy_body import correlated_noise
from rounded_block import block

from monitor.comparison import compare
from projects.model import Floats, Registration, Surface
from projects.transforms import rotation_from_vector

NOISE, REACH = 1e-4, 0.004  # m
SIGMAS = np.array([1e-4] * 3 + [2e-5] * 3)  # rad and m, of the motion
N_PAIRS = 200


def cut_off(depth: float) -> Floats:
    """Return the plane that takes a corner of the block, `depth` [m] along its diagonal."""
    n = np.array([0.62, -0.55, 0.56]) / np.linalg.norm([0.62, -0.55, 0.56])
    return np.append(n, n @ [0.06, -0.05, 0.04] - depth)


def press_bowl(surface: Surface, depth: float, radius: float) -> Surface:
    """Return the surface with a cosine bowl in its top."""
    v = surface.vertices.copy()
    r = np.hypot(v[:, 0], v[:, 1])
    top = (v[:, 2] > 0.035) & (r < radius)
    v[top, 2] -= 0.5 * depth * (1 + np.cos(np.pi * r[top] / radius))
    return dataclasses.replace(surface, vertices=v)


def simulate(surface: Surface, rng: np.random.Generator) -> Surface:
    """Return the surface as measured: noise along its normals, most of it correlated."""
    normals = trimesh.Trimesh(surface.vertices, surface.faces, process=False).vertex_normals
    error = correlated_noise(surface.vertices, rng, 0.98 * NOISE, REACH) + rng.normal(0, 0.2 * NOISE, len(normals))
    return dataclasses.replace(surface, vertices=surface.vertices + normals * error[:, None],
                               sigma=np.full(len(normals), NOISE))  # fmt: skip


def volumes_of(before: Surface, after: Surface, n_pairs: int) -> tuple[Floats, Floats]:
    """Return volume and sigma [m3] of the one region of each pair."""
    out = []
    for seed in range(n_pairs):
        rng = np.random.default_rng([7, seed])
        reference, compared = simulate(before, rng), simulate(after, rng)
        motion = rng.normal(0, SIGMAS)
        moved = compared.vertices @ rotation_from_vector(motion[:3]).T + motion[3:]
        registration = Registration(np.eye(4), np.diag(SIGMAS**2), np.zeros(3), True, stable_share=1.0,
                                    is_stable=np.ones(len(moved), dtype=bool))  # fmt: skip
        table = compare(reference, dataclasses.replace(compared, vertices=moved), registration).regions
        assert len(table) >= 1
        out.append(table.loc[0, ["volume_m3", "sigma_volume_m3"]].to_numpy(dtype=float))
    return np.array(out)[:, 0], np.array(out)[:, 1]


@pytest.mark.slow
@pytest.mark.parametrize("change", ["bowl", "broken corner"])
def test_true_volume_lies_within_what_is_stated(change: str) -> None:
    before = block(np.random.default_rng(1), None, False, noise=0.0)
    after = (press_bowl(before, 10.0 * 1.96 * np.sqrt(2.0) * NOISE, 0.03) if change == "bowl"
             else block(np.random.default_rng(1), cut_off(0.025), False, noise=0.0))  # fmt: skip
    truth = float(np.diff([trimesh.Trimesh(s.vertices, s.faces, process=False).volume for s in (before, after)])[0])
    volume, sigma = volumes_of(before, after, N_PAIRS)
    inside = float(np.mean(np.abs(volume - truth) <= 1.96 * sigma))
    scatter = float(np.std(volume))
    print(f"\n{change}: truth {1e9 * truth:.1f} mm3, mean {1e9 * volume.mean():.1f}, scatter {1e9 * scatter:.1f}, "
          f"stated {1e9 * np.median(sigma):.1f}; {inside:.1%} within 1.96 sigma")  # fmt: skip
    assert np.isfinite(volume).all()
    assert abs(volume.mean() / truth - 1.0) < 0.02
    assert 0.90 <= inside <= 0.99
    assert np.median(sigma) <= 2.0 * scatter
