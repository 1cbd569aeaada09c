"""Make the stored M3C2 figures: our own two clouds, compared by py4dgeo (see README.md)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import py4dgeo

HERE = Path(__file__).parent
SIZES = {"normal_radius": 0.08, "cylinder_radius": 0.05, "max_depth": 0.12, "registration_error": 0.001}  # m


def make_cloud(rng: np.random.Generator, n: int, change: float) -> np.ndarray:
    """Return a noisy wavy sheet of 1 m x 1 m (n, 3) with a bump of height `change` [m]; no points in one corner."""
    xy = rng.uniform(0, 1, (n, 2))
    xy = xy[(xy > 0.2).any(axis=1)]
    bump = change * np.exp(-((xy - 0.5) ** 2).sum(axis=1) / 0.02)
    z = 0.05 * np.sin(6 * xy[:, 0]) * np.cos(5 * xy[:, 1]) + bump + rng.normal(0, 2e-3, len(xy))
    return np.column_stack([xy, z]).astype(np.float32)


def main() -> None:
    """Write clouds.npz and m3c2.csv beside this file."""
    rng = np.random.default_rng(3)
    reference, compared = make_cloud(rng, 4000, 0.0), make_cloud(rng, 3000, 0.02)
    x, y = np.meshgrid(np.arange(0.025, 1.0, 0.05), np.arange(0.025, 1.0, 0.05))
    cores = np.column_stack([x.ravel(), y.ravel(), 0.05 * np.sin(6 * x.ravel()) * np.cos(5 * y.ravel())])
    cores = cores.astype(np.float32)
    np.savez_compressed(HERE / "clouds.npz", reference=reference, compared=compared, cores=cores)
    epochs = tuple(py4dgeo.Epoch(c.astype(np.float64)) for c in (reference, compared))
    found = py4dgeo.M3C2(
        epochs=epochs, corepoints=cores.astype(np.float64), normal_radii=[SIZES["normal_radius"]],
        cyl_radius=SIZES["cylinder_radius"], max_distance=SIZES["max_depth"],
        registration_error=SIZES["registration_error"], orientation_vector=np.array([0.0, 0.0, 1.0]),
    )  # fmt: skip
    distances, uncertainties = found.run()
    names = ("lodetection", "spread1", "num_samples1", "spread2", "num_samples2")
    table = np.column_stack([distances, *(uncertainties[name] for name in names)])
    np.savetxt(HERE / "m3c2.csv", table, fmt="%.12e", delimiter=",", header="distance," + ",".join(names), comments="")


if __name__ == "__main__":
    main()
