"""Make the stored cloud-to-mesh distances: our own two surfaces, measured by CloudCompare (see README.md).

python tests/validation/cloudcompare/make_c2m.py [CloudCompare]
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import trimesh

HERE = Path(__file__).parent
RADIUS, RELIEF, CHANGE = 0.2, 0.012, 0.004  # m


def relief(directions: np.ndarray, seed: int, n_waves: int, height: float) -> np.ndarray:
    """Return a sum of waves (n,) [m] over unit directions (n, 3)."""
    rng = np.random.default_rng(seed)
    waves, phases = 6.0 * rng.normal(size=(n_waves, 3)), rng.uniform(0, 2 * np.pi, n_waves)
    return height / np.sqrt(n_waves) * np.cos(directions @ waves.T + phases).sum(axis=1)


def make_body(subdivisions: int, turn: float, change: float) -> trimesh.Trimesh:
    """Return a bumpy ball, cut open at the top: `turn` [rad] gives it other vertices, `change` [m] another shape."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    ball.apply_transform(trimesh.transformations.rotation_matrix(turn, [0.3, 0.5, 0.8]))
    d = ball.vertices
    radius = RADIUS + relief(d, 1, 10, RELIEF) + relief(d, 2, 6, change)
    body = trimesh.Trimesh(d * radius[:, None], ball.faces, process=False)
    body.update_faces((d[ball.faces][:, :, 2] < 0.85).all(axis=1))
    body.remove_unreferenced_vertices()
    return body


def measure(program: str, compared: trimesh.Trimesh, reference: trimesh.Trimesh) -> np.ndarray:
    """Return the signed distance of each vertex of `compared` to `reference` (n,) [m], by CloudCompare."""
    with tempfile.TemporaryDirectory() as folder:
        points, mesh, out = (Path(folder) / name for name in ("points.xyz", "mesh.ply", "out.asc"))
        np.savetxt(points, compared.vertices, fmt="%.17g")
        reference.export(mesh)
        subprocess.run(
            [program, "-SILENT", "-AUTO_SAVE", "OFF", "-C_EXPORT_FMT", "ASC", "-PREC", "12",
             "-O", str(points), "-O", str(mesh), "-C2M_DIST", "-SAVE_CLOUDS", "FILE", str(out)],
            check=True, timeout=300, env={"QT_QPA_PLATFORM": "offscreen", "HOME": folder, "PATH": "/usr/bin"},
        )  # fmt: skip
        return np.loadtxt(out)[:, -1]


def main() -> None:
    """Write reference.ply, compared.ply and c2m.csv beside this file."""
    program = sys.argv[1] if len(sys.argv) > 1 else "CloudCompare"
    reference, compared = make_body(4, 0.0, 0.0), make_body(4, 1.0, CHANGE)
    bodies = []
    for name, body in (("reference", reference), ("compared", compared)):
        path = HERE / f"{name}.ply"
        body.export(path)  # single precision, which is what CloudCompare reads
        bodies.append(trimesh.load(path, process=False))
    np.savetxt(HERE / "c2m.csv", measure(program, bodies[1], bodies[0]), fmt="%.9e", header="c2m_m", comments="")


if __name__ == "__main__":
    main()
