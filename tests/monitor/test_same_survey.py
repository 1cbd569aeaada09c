"""The same measurements in two epochs are no second survey: told by their content, and never compared."""

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from monitor.cli import run
from monitor.comparison import compare
from monitor.record import Place
from monitor.same_survey import count_at, find_shared
from projects import Project, Registration, Surface
from projects.errors import ComparisonError
from projects.formats import write_ply_mesh
from projects.model import Assessment

POSE = "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1 0 0 4"


def sheet(rng: np.random.Generator) -> Surface:
    """Return a wavy sheet of 20 x 20 vertices, 10 cm wide, with 0.1 mm of noise."""
    x, y = (a.ravel() for a in np.meshgrid(*[np.linspace(0, 0.1, 20)] * 2, indexing="ij"))
    i = np.arange(400).reshape(20, 20)
    a, b, c, d = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
    points = np.column_stack([x, y, 1 + 0.01 * np.sin(60 * x) * np.cos(50 * y) + rng.normal(0, 1e-4, 400)])
    return Surface(points, np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])]))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write scans a, b, c and d of the same sheet; a once more with fewer digits and once in another order, b as a PLY
    of single precision."""
    out, rng = tmp_path_factory.mktemp("scans"), np.random.default_rng(11)
    for name in "abcd":
        np.savetxt(out / f"{name}.xyz", sheet(rng).vertices, fmt="%.9f")
    np.savetxt(out / "a-again.xyz", np.loadtxt(out / "a.xyz"), fmt="%.5f")
    np.savetxt(out / "a-mixed.xyz", rng.permutation(np.loadtxt(out / "a.xyz")), fmt="%.6f")
    b = np.loadtxt(out / "b.xyz").astype("<f4")
    header = "ply\nformat binary_little_endian 1.0\nelement vertex 400\n" + "".join(
        f"property float {axis}\n" for axis in "xyz"
    )
    (out / "b-again.ply").write_bytes(f"{header}end_header\n".encode() + b.tobytes())
    return out


def add(project: Path, epoch: str, folder: Path, *names: str) -> int:
    """Add an epoch of these scans of a folder."""
    poses = project.parent / f"{epoch}.poses"
    poses.write_text("".join(f"{name} {POSE}\n" for name in names))
    given = ["add-epoch", str(project), "sheet", epoch, "--date", "2026-05-01", "--poses", str(poses), "--json"]
    return run([*given, *(str(folder / name) for name in names)])


@pytest.fixture
def project(tmp_path: Path, folder: Path) -> Path:
    """Return a project with the epoch e1 of scans a and b."""
    path = tmp_path / "project"
    assert run(["init", str(path)]) == 0
    assert run(["add-object", str(path), "sheet"]) == 0
    assert add(path, "e1", folder, "a.xyz", "b.xyz") == 0
    return path


@pytest.mark.parametrize(
    ("files", "shared"),
    [
        (("a.xyz", "b.xyz"), [("a.xyz", "a.xyz"), ("b.xyz", "b.xyz")]),
        (("c.xyz", "b-again.ply"), [("b.xyz", "b-again.ply")]),
        (("a-again.xyz", "d.xyz"), [("a.xyz", "a-again.xyz")]),
        (("c.xyz", "a-mixed.xyz"), [("a.xyz", "a-mixed.xyz")]),
        (("c.xyz", "d.xyz"), []),
    ],
)
def test_scans_in_two_epochs_are_found_by_their_points(
    project: Path, folder: Path, capsys: pytest.CaptureFixture[str], files: tuple[str, str], shared: list[object]
) -> None:
    capsys.readouterr()
    assert add(project, "e2", folder, *files) == 0
    told = capsys.readouterr()
    assert json.loads(told.out)["copies"] == [f"{b} is {a} of epoch e1" for a, b in shared]
    opened = Project.open(project)
    assert find_shared(Place(opened, "sheet", "e1"), Place(opened, "sheet", "e2")) == shared
    assert run(["compare", str(project), "sheet", "e1", "e2"]) == 2
    said = capsys.readouterr().err
    assert ("hold the same measurements" in said) == bool(shared)
    assert ("monitor remove-epoch" in said) == bool(shared)


@pytest.mark.parametrize(
    ("files", "doubles"),
    [
        (("a.xyz", "c.xyz", "a-mixed.xyz"), ["a-mixed.xyz is a.xyz"]),
        (("b-again.ply", "b.xyz"), ["b.xyz is b-again.ply"]),
        (("a.xyz", "b.xyz"), []),
    ],
)
def test_a_scan_twice_in_one_epoch_is_told_by_its_points(
    tmp_path: Path, folder: Path, capsys: pytest.CaptureFixture[str], files: tuple[str, ...], doubles: list[str]
) -> None:
    """In another format or order it counted, silently, as a second scan that agrees perfectly."""
    path = tmp_path / "project"
    assert run(["init", str(path)]) == run(["add-object", str(path), "sheet"]) == 0
    capsys.readouterr()
    assert add(path, "e1", folder, *files) == 0
    told = capsys.readouterr()
    assert json.loads(told.out)["doubles"] == doubles
    assert ("measured once, it counts as scans that agree perfectly" in told.err) == bool(doubles)


def test_one_mesh_in_two_epochs_is_found_whatever_its_file_is_called(
    project: Path, tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    write_ply_mesh(tmp_path / "old.ply", sheet(rng))
    shutil.copy(tmp_path / "old.ply", tmp_path / "new.ply")
    write_ply_mesh(tmp_path / "other.ply", sheet(rng))
    for name in ("old", "new", "other"):
        given = ["add-epoch", str(project), "sheet", name, "--date", "2026-05-01", "--mesh"]
        assert run([*given, str(tmp_path / f"{name}.ply")]) == 0
    assert "mind: new.ply is old.ply of epoch old: one survey, not two" in capsys.readouterr().err
    assert run(["compare", str(project), "sheet", "old", "new"]) == 2
    assert "hold the same measurements (old.ply is new.ply)" in capsys.readouterr().err
    assert run(["compare", str(project), "sheet", "old", "other"]) == 2
    assert "has no surface yet" in capsys.readouterr().err


def test_another_survey_in_the_same_grid_and_bounds_is_another(rng: np.random.Generator) -> None:
    """Coordinates rounded to a millimetre: places coincide by chance, how many points lie at each does not."""
    grids = [np.round(rng.uniform(0.0, 0.03, (3000, 3)) * [1.0, 1.0, 0.1], 3) for _ in range(2)]
    places = np.unique(grids[0], axis=0)
    one, same, other = (count_at(places, [g], 1e-5) for g in (grids[0], rng.permutation(grids[0]), grids[1]))
    assert np.array_equal(one, same)
    assert np.mean(one == other) < 0.5


def test_a_mesh_that_was_edited_is_no_second_survey(
    project: Path, tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    """Where its vertices stayed no error shows: a level of detection of 0.00 mm was told of it."""
    mesh = sheet(rng)
    dented = mesh.vertices - 2e-3 * (np.hypot(*(mesh.vertices[:, :2] - 0.05).T) < 0.02)[:, None] * [0.0, 0.0, 1.0]
    write_ply_mesh(tmp_path / "old.ply", mesh)
    write_ply_mesh(tmp_path / "dented.ply", dataclasses.replace(mesh, vertices=dented))
    for name in ("old", "dented"):
        given = ["add-epoch", str(project), "sheet", name, "--date", "2026-05-01", "--mesh"]
        assert run([*given, str(tmp_path / f"{name}.ply")]) == 0
    assert "mind: most of dented.ply is old.ply of epoch old: one survey, not two" in capsys.readouterr().err
    assert run(["process", str(project), "sheet", "old"]) == 0
    assert run(["process", str(project), "sheet", "dented"]) == 0
    assert run(["compare", str(project), "sheet", "old", "dented"]) == 2
    assert "hold the same measurements (old.ply is most of dented.ply)" in capsys.readouterr().err


def test_a_surface_against_itself_has_the_level_that_it_states_and_none_where_it_states_nothing(
    rng: np.random.Generator,
) -> None:
    """What both sides share shows no error: a level learned from it was zero."""
    surface = dataclasses.replace(sheet(rng), sigma=np.full(400, 1e-4))
    unmoved = Registration(np.eye(4), np.zeros((6, 6)), np.zeros(3), True)
    side = compare(surface, dataclasses.replace(surface), unmoved).on_compared
    known = np.isfinite(side.lod95)
    assert known.mean() > 0.5
    assert side.lod95[known].min() >= 1.96 * 1e-4  # of this side's vertices alone
    assert np.median(side.lod95[known]) == pytest.approx(1.96 * np.sqrt(2.0) * 1e-4, rel=0.15)
    assert not (side.assessment == Assessment.CHANGED).any()
    bare = dataclasses.replace(surface, sigma=None)
    with pytest.raises(ComparisonError, match="is the reference itself, vertex by vertex, and states no sigma"):
        compare(bare, dataclasses.replace(bare), unmoved)
