"""A run that compiles its kernels and the next, which finds them compiled, make the same bits."""

import os
import subprocess
import sys
from pathlib import Path

RUN = """
import hashlib

import numpy as np

from monitor.reconstruction.quadric import fit_patch, fit_room

rng = np.random.default_rng(4)
digest, n_fitted = hashlib.sha256(), 0
for n in range(20, 220):
    patch = np.zeros((10, n))
    patch[:2] = rng.uniform(-0.7, 0.7, (2, n))
    patch[2] = 0.2 * patch[0] ** 2 + 0.01 * rng.normal(size=n)
    patch[3] = rng.integers(1, 9, n)
    patch[[4, 6, 9]] = 0.001 * rng.uniform(size=(3, n))
    out, influence = np.zeros(7), np.zeros(n)
    n_fitted += fit_patch(patch, n, 0.01, 1.0, 1.0, 2, fit_room(n), out, influence)
    digest.update(out.tobytes() + influence.tobytes())
print(n_fitted, digest.hexdigest())
"""


def test_a_run_that_compiles_makes_the_bits_of_the_next(tmp_path: Path) -> None:
    first, second = (
        subprocess.run(
            [sys.executable, "-c", RUN],
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
            check=True,
            capture_output=True,
            text=True,
        ).stdout.split()
        for _ in range(2)
    )
    assert first[0] == "200"
    assert first == second
