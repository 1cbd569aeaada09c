"""`monitor plan`: where to stand and how finely to scan, told as a table, a list of stations and a coloured surface."""

import dataclasses
import json

import numpy as np
import pandas as pd
import pytest
import trimesh

from monitor.cli import run
from monitor.cli.planning import _properties
from monitor.simulation import INSTRUMENTS, Visibility, visible_change
from monitor.simulation.planning import spread_points
from monitor.simulation.resolution import Plan, Task, choose_plan, plan_resolutions, see_vertices, stand_around_body
from monitor.simulation.scenes import Scene, make_ball, make_box

AT = np.array([350.0, -120.0, 40.0])  # project coordinates far from the origin
PHOTON = INSTRUMENTS["faro-photon120"]


@pytest.fixture(scope="module")
def ball_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("plan") / "ball.ply"
    trimesh.creation.icosphere(subdivisions=3, radius=0.5).apply_translation(AT).export(path)
    return path


def ask(capsys, *words):
    code = run(["plan", *map(str, words)])
    said = capsys.readouterr()
    return code, said.out, said.err


def plan(fraction, n_stations, n_pulses, shown):
    none = np.empty(0)
    return Plan(
        fraction, 0.001 * fraction, tuple(range(n_stations)), n_pulses, Visibility(*[none] * 6), shown, 0.0, 0.0
    )


def test_the_advice_has_the_fewest_stations_then_the_fewest_pulses_of_the_plans_that_show_as_much():
    plans = [plan(1, 4, 900, 0.95), plan(2, 4, 200, 0.945), plan(4, 5, 60, 0.948), plan(8, 4, 20, 0.90)]
    assert choose_plan(plans).fraction == 2
    assert choose_plan(plans[2:]).fraction == 4
    assert choose_plan([plans[0], dataclasses.replace(plans[3], shown=0.941)]).fraction == 8


def test_places_stand_level_outside_the_body_and_face_it():
    body = make_box("block", [-0.3, -0.4, 1.0], [0.3, 0.4, 3.0])
    poses = stand_around_body(body, distances=[2.0, 4.0], heights=[1.5], every=np.radians(90.0))
    at = np.array([pose[:3, 3] for pose in poses])
    assert len(poses) == 8
    np.testing.assert_allclose(at[0], [0.0, -2.5, 2.5], atol=1e-12)  # half the diagonal is 0.5 m
    np.testing.assert_allclose(np.hypot(at[:, 0], at[:, 1]), [2.5] * 4 + [4.5] * 4)
    for pose in poses:
        assert pose[2, 2] == 1.0
        np.testing.assert_allclose(pose[:2, 0], -pose[:2, 3] / np.linalg.norm(pose[:2, 3]), atol=1e-12)


def test_each_resolution_is_planned_as_one_would_by_hand():
    ball = make_ball("ball", np.zeros(3), 0.4, n_rings=30)
    places = stand_around_body(ball, distances=[3.0], heights=[0.4], every=np.radians(60.0))
    task = Task(change=0.002, extent=0.02, sigma_registration=0.0002)
    fine, coarse = plan_resolutions(ball, (), PHOTON, places, task, fractions=(8, 2), n_points=500)
    assert (fine.fraction, coarse.fraction) == (2, 8)
    points, normals = spread_points(ball, 500, seed=0)
    by_hand = visible_change(
        Scene("ball", (ball,)), PHOTON, [places[k] for k in fine.taken], points, normals, step=2 * PHOTON.angular_step,
        extent=0.02, sigma_registration=0.0002,
    )  # fmt: skip
    np.testing.assert_array_equal(fine.seen.smallest_change, by_hand.smallest_change)
    assert fine.shown == np.mean(by_hand.smallest_change <= 0.002)
    assert fine.unseen + fine.too_few == np.mean(by_hand.n_stations == 0)
    assert fine.unseen == np.mean(~by_hand.in_sight)
    # A window of twice asin(0.4 / 3.4) both ways at least: the box's corners lie a little further out.
    across = 2.0 * np.arcsin(0.4 / (3.0 + np.hypot(0.4, 0.4))) / fine.step
    assert 1.0 < fine.n_pulses / len(fine.taken) / across**2 < 2.2


def test_a_vertex_is_judged_by_the_mean_normal_of_its_faces():
    ball = make_ball("ball", np.zeros(3), 0.4, n_rings=40)
    (place,) = stand_around_body(ball, distances=[3.0], heights=[0.4], every=2.0 * np.pi)
    seen = see_vertices(ball, (), PHOTON, [place], PHOTON.angular_step, Task())
    by_hand = visible_change(
        Scene("ball", (ball,)), PHOTON, [place], ball.vertices, ball.vertices / 0.4, sigma_registration=0.0003
    )
    # Faces of 3 cm turn their mean normal a little from the ball's, which tells at grazing views only.
    both = by_hand.smallest_change < 0.00086
    assert both.sum() > 0.35 * len(ball.vertices)
    np.testing.assert_allclose(seen.smallest_change[both], by_hand.smallest_change[both], rtol=0.02)


def test_the_plan_of_a_mesh_names_stations_around_it_and_colours_what_they_show(ball_file, tmp_path, capsys):
    code, said, _ = ask(capsys, ball_file, "--out", tmp_path, "--scanner", "faro-photon120", "--heights", "0.5")
    assert "smallest change: what one place differs from zero by at 95 %" in said
    assert code == 0
    assert "advice (*): 1/" in said
    stations = pd.read_csv(tmp_path / "stations.csv")
    off = stations[["x_m", "y_m", "z_m"]].to_numpy() - AT
    np.testing.assert_allclose(np.hypot(off[:, 0], off[:, 1]), 3.5 + 0.5 * np.sqrt(2.0), atol=0.002)
    np.testing.assert_allclose(off[:, 2], 0.0, atol=0.002)  # 0.5 m above the foot: the ball's middle
    assert 3 <= len(stations) <= 5
    mesh = trimesh.load_mesh(tmp_path / "surface.ply", process=False)
    colors, found = mesh.visual.vertex_colors[:, :3], mesh.metadata["_ply_raw"]["vertex"]["data"]
    z = np.asarray(mesh.vertices)[:, 2] - AT[2]
    is_green = (colors == (70, 150, 90)).all(axis=1)
    assert is_green[np.abs(z) < 0.3].mean() > 0.9
    np.testing.assert_array_equal(is_green, found["smallest_change"].ravel() <= 0.002)
    assert (found["n_stations"].ravel()[(colors == 150).all(axis=1)] == 0).all()
    assert (found["n_stations"].ravel()[z < -0.49] == 0).all()  # from the height of its middle, its foot is not seen


def test_stations_are_counted_beyond_what_a_byte_holds():
    counts = np.array([0.0, 255.0, 256.0, 300.0])
    told = _properties(Visibility(counts, *[np.full(4, 0.001)] * 4, counts > 0.0), Task())
    assert told["n_stations"].tolist() == [0, 255, 256, 300]


def test_what_stands_beside_hides_and_a_program_reads_the_answer(ball_file, tmp_path, capsys):
    wall = tmp_path / "wall.ply"
    trimesh.creation.box(extents=[6.0, 0.1, 6.0]).apply_translation(AT - np.array([0.0, 0.8, 0.0])).export(wall)
    options = ["--out", tmp_path / "out", "--heights", "0.5", "--every", "180", "--json"]
    alone, hidden = (
        json.loads(ask(capsys, ball_file, *options, *more)[1]) for more in ([], ["--beside", str(wall)])
    )  # fmt: skip
    assert alone["change_mm"] == 2.0
    assert [r["resolution"] for r in alone["resolutions"]] == ["1/1", "1/2", "1/4", "1/8", "1/16"]
    spacings = [r["spacing_mm"] for r in alone["resolutions"][:3]]
    np.testing.assert_allclose(np.diff(np.log2(spacings)), 1.0, atol=0.05)
    for r in alone["resolutions"]:
        assert r["shown"] + r["too_few_pulses"] + r["unseen"] <= 1.002
    assert alone["advice"]["too_few_pulses"] < 0.1
    assert len(alone["advice"]["stations"]) == 2
    assert [s["angle_deg"] for s in hidden["advice"]["stations"]] == [90.0]  # the one in front looks at the wall
    assert hidden["advice"]["unseen"] > alone["advice"]["unseen"] + 0.2


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--scanner", "tape"], "--scanner tape: known presets are faro-ls880"),
        (["--change", "0"], "--change 0.0: a length above 0 mm is needed"),
        (["--distances", "3,far"], "--distances 3,far: metres above 0 are needed"),
        (["--every", "0"], "--every 0: degrees from 1 to 360 are needed"),
        (["--every", "0.001"], "--every 0.001: degrees from 1 to 360 are needed"),
        (["--every", "nan"], "--every nan: degrees from 1 to 360 are needed"),
        (["--reflectance", "2"], "--reflectance 2: a share of the light is needed, above 0, up to 1"),
        (["--reflectance", "0"], "--reflectance 0: a share of the light is needed, above 0, up to 1"),
        (["--width", "1e9"], "--width 1e+09: ball.ply is 1732 mm across; millimetres up to that are needed"),
        (["--change", "2000"], "--change 2000: ball.ply is 1732 mm across"),
        (["--distances", "200"], "shows nowhere from 16 places"),
        (["--registration", "-1"], "--registration -1: millimetres are needed, 0 or more"),
        (["--registration", "inf"], "--registration inf: millimetres are needed, 0 or more"),
    ],
)
def test_a_question_without_an_answer_is_refused_in_one_line(ball_file, tmp_path, capsys, words, says):
    code, _, complaint = ask(capsys, ball_file, "--out", tmp_path / "none", *words)
    assert code == 2
    assert says in complaint
    assert complaint.count("\n") == 1
    assert not (tmp_path / "none").exists()


def test_a_drawing_in_millimetres_is_questioned_as_an_epoch_is(tmp_path, capsys):
    for name, size in (("figure", 1000.0), ("wall", 1.0)):
        trimesh.creation.box(extents=[size] * 3).export(tmp_path / f"{name}.ply")
    told = "figure.ply is 1000 m across if its numbers are metres, which is improbable"
    for words in ((tmp_path / "figure.ply",), (tmp_path / "wall.ply", "--beside", tmp_path / "figure.ply")):
        code, _, complaint = ask(capsys, *words, "--out", tmp_path / "out", "--heights", "0.5")
        assert (code, told in complaint) == (2, True)
    asked = [tmp_path / "figure.ply", "--out", tmp_path / "out", "--heights", "0.5", "--unit", "mm"]
    assert ask(capsys, *asked)[0] == 0


def test_a_folder_that_cannot_be_written_is_refused_before_the_mesh_is_read(tmp_path, capsys):
    (tmp_path / "file").touch()
    code, _, complaint = ask(capsys, tmp_path / "none.ply", "--out", tmp_path / "file" / "out")
    assert code == 2
    assert complaint == f"monitor: --out {tmp_path}/file/out: {tmp_path}/file is a file; another folder is needed\n"
