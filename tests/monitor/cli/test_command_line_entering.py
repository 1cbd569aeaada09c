"""The command line where objects and epochs are entered: what is kept, and what is said of it; nothing is computed."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from monitor.cli import run
from projects import Project


@pytest.mark.parametrize(("said", "degrees"), [
    ("north", 0), ("east", 90), ("South", 180), ("west", 270), ("135", 135), ("22.5", 22.5), ("0", 0), ("360", 0),
])  # fmt: skip
def test_the_front_of_an_object_is_kept_as_a_bearing(tmp_path: Path, said: str, degrees: float) -> None:
    path = str(tmp_path / "p")
    assert run(["init", path]) == 0
    assert run(["add-object", path, "head", "--front", said]) == 0
    assert run(["add-object", path, "vase"]) == 0
    project = Project.open(path)
    assert project.object("head").front == pytest.approx(np.radians(degrees), abs=1e-15)
    assert project.object("vase").front is None


def test_a_front_that_was_guessed_is_set_and_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(tmp_path / "p")
    assert run(["init", path]) == 0
    assert run(["add-object", path, "head", "--name", "Head"]) == 0
    assert run(["set-front", path, "head", "East"]) == 0
    assert "faces east (90 degrees clockwise from +y) from now on; it was found from" in capsys.readouterr().out
    assert run(["set-front", path, "head", "225"]) == 0
    out = capsys.readouterr().out
    assert "it faced east" in out
    assert f"monitor report {path} head" in out
    head = Project.open(Path(path)).object("head")
    assert head.front == pytest.approx(np.radians(225.0), abs=1e-15)
    assert head.name == "Head"


def test_names_are_shown_as_they_are_given_whatever_brackets_they_hold(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    project, name, long = str(tmp_path / "p"), "Kopf [kopie von 1890] [/] Ende", "a" * 64
    assert run(["init", project]) == 0
    assert run(["add-object", project, long, "--name", name]) == 0
    capsys.readouterr()
    assert run(["status", project]) == 0
    assert f"{long}  {name}" in capsys.readouterr().out  # uncut, too


@pytest.mark.parametrize("suffix", ["ply", "obj", "stl", "glb"])
def test_a_mesh_that_is_taken_for_points_is_told_and_points_are_not(
    suffix: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nobody asked for --mesh: the vertices are a scan, whatever the file holds besides."""
    project, ball = tmp_path / "p", trimesh.creation.icosphere(subdivisions=3, radius=0.1)
    ball.export(tmp_path / f"mesh.{suffix}")
    trimesh.PointCloud(ball.vertices).export(tmp_path / "points.ply")
    np.savetxt(tmp_path / "points.obj", ball.vertices, fmt="v %.6f %.6f %.6f")
    assert run(["init", str(project)]) == 0
    assert run(["add-object", str(project), "ball"]) == 0
    points = [f"points.{suffix}"] if suffix in ("ply", "obj") else []
    for k, name in enumerate([f"mesh.{suffix}", *points]):
        assert run(["add-epoch", str(project), "ball", f"e{k}", "--date", "2026-05-01", str(tmp_path / name)]) == 0
        err = capsys.readouterr().err
        told = f"mind: {name}: a mesh, of which the vertices were taken as the points of a scan"
        assert (told in err) == (k == 0)
        assert ("--mesh" in err) == (k == 0)
    mesh = ["--mesh", str(tmp_path / f"mesh.{suffix}")]
    assert run(["add-epoch", str(project), "ball", "finished", "--date", "2026-05-01", *mesh]) == 0
    assert "mind" not in capsys.readouterr().err


def test_an_epoch_called_series_is_refused_before_its_files_are_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    project = tmp_path / "p"
    assert run(["init", str(project)]) == 0
    assert run(["add-object", str(project), "ball"]) == 0
    capsys.readouterr()
    missing = str(tmp_path / "missing.ply")
    assert run(["add-epoch", str(project), "ball", "series", "--date", "2026-05-01", "--mesh", missing]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "epoch id 'series' stands for change over all epochs in names of exported files" in line
    assert "missing.ply" not in line


def test_what_is_left_out_of_a_finished_mesh_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    project, ball = tmp_path / "p", trimesh.creation.icosphere(subdivisions=2, radius=0.1)
    corners = [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in [*ball.vertices, (9.0, 9.0, 9.0), (8.0, 9.0, 9.0)]]
    faces = [f"f {a} {b} {c}" for a, b, c in ball.faces + 1]
    (tmp_path / "ball.obj").write_text("\n".join([*corners, *faces, "f 1 2 2"]))
    assert run(["init", str(project)]) == 0
    assert run(["add-object", str(project), "ball"]) == 0
    capsys.readouterr()
    mesh = ["--mesh", str(tmp_path / "ball.obj")]
    assert run(["add-epoch", str(project), "ball", "e1", "--date", "2026-05-01", *mesh]) == 0
    told = "a mesh; 2 vertices of no triangle left out; 1 triangles without three corners left out\n"
    assert capsys.readouterr().out.endswith(told)
    assert run(["add-epoch", str(project), "ball", "e2", "--date", "2027-05-01", *mesh, "--json"]) == 0
    dropped = json.loads(capsys.readouterr().out)["dropped"]
    assert dropped == {"vertices_of_no_triangle": 2, "triangles_without_three_corners": 1}


def test_an_epoch_that_is_entered_is_told_though_others_are_damaged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    project = tmp_path / "p"
    assert run(["init", str(project)]) == 0
    assert run(["add-object", str(project), "ball"]) == 0
    for k in (1, 2):
        file = tmp_path / f"e{k}.ply"
        trimesh.creation.icosphere(subdivisions=3, radius=0.1 + 0.001 * k).export(file)
        assert run(["add-epoch", str(project), "ball", f"e{k}", "--date", f"202{k}-05-01", "--mesh", str(file)]) == 0
        if k == 1:
            (mesh,) = (project / "objects" / "ball" / "e1").glob("mesh-*.h5")
            with open(mesh, "r+b") as damaged:
                damaged.seek(mesh.stat().st_size // 2)
                damaged.write(b"damaged")
    said = capsys.readouterr()
    assert "epoch e2 added" in said.out
    assert "mind: whether another epoch holds the same scans is not known" in said.err
    assert run(["verify", str(project)]) == 2
    said = capsys.readouterr()
    assert "take the epoch out and add it again from its files" in said.err
    assert "monitor process" not in said.out + said.err


def test_status_tells_a_file_that_is_missing_from_one_that_was_never_made(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, ball = tmp_path / "p", trimesh.creation.icosphere(subdivisions=3, radius=0.1)
    np.savetxt(tmp_path / "points.xyz", ball.vertices, fmt="%.6f")
    assert run(["init", str(path)]) == 0
    assert run(["add-object", str(path), "ball"]) == 0
    assert run(["add-epoch", str(path), "ball", "e1", "--date", "2026-05-01", str(tmp_path / "points.xyz")]) == 0
    capsys.readouterr()
    assert run(["status", str(path)]) == 0
    told = capsys.readouterr()
    assert "642 │ to do" in told.out
    assert not told.err
    next(path.glob("objects/ball/e1/raw-*.h5")).unlink()
    assert run(["status", str(path)]) == 0
    told = capsys.readouterr()
    assert "file missing │ to do" in told.out
    assert f"monitor verify {path} names them" in told.err
    assert run(["status", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["objects"][0]["epochs"][0]["without_file"] == ["raw"]


def test_without_a_command_what_may_be_asked_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    assert run([]) == 2
    told = capsys.readouterr().err
    assert told.startswith("Usage: monitor [OPTIONS] COMMAND")
    assert "add-epoch" in told


def test_help_says_what_a_file_of_an_extent_holds_and_what_exports_are(capsys: pytest.CaptureFixture[str]) -> None:
    for command, words in (
        ("add-object", ("in metres", '{"box": {"min": [x, y, z], "max": [x, y, z]}}', '"bottom": z, "top": z}')),
        ("export", ("a light GLB of one epoch", "in the reference epoch's coordinates", "what was gained is positive")),
    ):
        assert run([command, "--help"]) == 0
        told = " ".join(capsys.readouterr().out.split())
        for word in words:
            assert word in told, word


def test_debug_shows_where_an_error_came_from_and_changes_no_exit_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["status", str(tmp_path / "nowhere")], debug=True) == 2
    told = capsys.readouterr().err
    assert "Traceback" in told
    assert told.splitlines()[-1].startswith("monitor: ")


def test_epochs_without_surfaces_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, points = str(tmp_path / "my project"), trimesh.creation.icosphere(subdivisions=3, radius=0.1).vertices
    assert run(["init", path]) == 0
    assert run(["add-object", path, "ball"]) == 0
    for k in range(3):
        np.savetxt(tmp_path / f"{k}.xyz", points + 1e-4 * k, fmt="%.6f")
        added = ["add-epoch", path, "ball", f"e{k}", "--date", f"202{k}-05-01", str(tmp_path / f"{k}.xyz")]
        assert run(added) == 0
    capsys.readouterr()
    assert run(["compare", path, "ball"]) == 2
    said = [line for line in capsys.readouterr().err.splitlines() if line.startswith("monitor: ")]
    assert len(said) == 1
    assert "epochs e0, e1 and e2 of object ball have no surface yet" in said[0]
    assert said[0].endswith(f"run: monitor process '{path}' ball")  # as a shell takes it


@pytest.mark.parametrize(("place", "dropped"), [("0 0 0", {"no return": 1}), ("0 0 1", {})])
def test_a_point_where_the_scanner_is_said_to_have_stood_is_no_measurement(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], place: str, dropped: dict[str, int]
) -> None:
    path, points = str(tmp_path / "p"), trimesh.creation.icosphere(subdivisions=3, radius=0.1).vertices
    np.savetxt(tmp_path / "a.xyz", np.r_[points + 1.0, np.zeros((1, 3))], fmt="%.6f")
    (tmp_path / "poses.txt").write_text(f"a.xyz 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1 {place}\n", encoding="utf-8")
    assert run(["init", path]) == 0
    assert run(["add-object", path, "ball"]) == 0
    capsys.readouterr()
    added = ["add-epoch", path, "ball", "e1", "--date", "2026-05-01", "--poses", str(tmp_path / "poses.txt")]
    assert run([*added, "--json", str(tmp_path / "a.xyz")]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["n_points"], told["dropped"]) == (len(points) + 1 - len(dropped), dropped)


def add_file(project: Path, epoch: str, file: Path, *options: str) -> int:
    """Add an epoch of one file to the object of a project, which is made where it is not there."""
    if not project.exists():
        assert run(["init", str(project)]) == run(["add-object", str(project), "head"]) == 0
    return run(["add-epoch", str(project), "head", epoch, "--date", "2026-05-01", *options, str(file)])


def test_columns_that_could_not_be_told_and_units_in_their_names_are_told(
    tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    points, project = rng.random((300, 3)), tmp_path / "p"
    np.savetxt(tmp_path / "a.xyz", np.column_stack([points, rng.random((300, 2))]), fmt="%.6f")
    assert add_file(project, "e1", tmp_path / "a.xyz") == 0
    assert "mind: a.xyz: columns 4 to 5 could not be told and left out" in capsys.readouterr().err
    np.savetxt(tmp_path / "b.xyz", points, fmt="%.6f", header="X [ft] Y [ft] Z [ft]")
    assert add_file(project, "e2", tmp_path / "b.xyz") == 2
    assert "b.xyz says that its coordinates are in ft; state it: --unit ft" in capsys.readouterr().err
    assert add_file(project, "e2", tmp_path / "b.xyz", "--unit", "ft") == 0
    assert "could not be told" not in capsys.readouterr().err
    header = Project.open(project).scan_headers("head", "e2")[0]
    assert np.ptp(header.bounds, axis=0).max() == pytest.approx(0.3048, rel=0.05)


def test_a_vertex_of_no_face_is_nowhere_in_the_project(tmp_path: Path) -> None:
    ball, project = trimesh.creation.icosphere(subdivisions=2, radius=0.1), tmp_path / "p"
    for name, last in (("a", "nan nan nan"), ("b", "0 0 500")):
        vertices = "".join(f"v {x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in ball.vertices + 0.01 * (name == "b"))
        faces = "".join(f"f {a} {b} {c}\n" for a, b, c in ball.faces + 1)
        (tmp_path / f"{name}.obj").write_text(f"{vertices}v {last}\n{faces}")
        assert add_file(project, name, tmp_path / f"{name}.obj", "--mesh") == 0
        assert len(Project.open(project).get("head", name, "mesh").vertices) == len(ball.vertices)


def test_a_mesh_of_a_building_in_a_format_that_defines_metres_is_not_questioned(tmp_path: Path) -> None:
    trimesh.creation.box((300.0, 40.0, 20.0)).export(tmp_path / "palace.glb")
    trimesh.creation.box((300.0, 40.0, 20.0)).export(tmp_path / "palace.ply")
    assert add_file(tmp_path / "p", "e1", tmp_path / "palace.glb", "--mesh") == 0
    assert add_file(tmp_path / "p", "e2", tmp_path / "palace.ply", "--mesh") == 2
