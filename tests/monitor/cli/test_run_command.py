"""A campaign in one file: all of it is done, again does nothing, and what is wrong in it is said before work begins."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from monitor.cli import run
from monitor.cli.campaign_file import read_campaign
from monitor.cli.declared import _are_same_poses
from projects import Project
from projects.bags import verify_bag
from projects.formats import PoseLine, write_ply_mesh
from projects.model import Surface
from projects.raw import ScanHeader
from projects.transforms import perturb
from reports import pictures

CAMPAIGN = """
project = "project"
name = "Attic"
crs = "EPSG:31256"
report = "out/reports"
export = "out/files"
formats = "ply,csv"
archive = "out/archive"

[[object]]
id = "minerva"
name = "Minerva"
material = "marble"
extent = "box.json"
tolerance = 2
front = "south"

[[object.epoch]]
id = "before"
date = 2025-05-12
mesh = true
files = ["before.ply"]

[[object.epoch]]
id = "after"
date = "2026-05-18"
label = "after the restoration"
mesh = true
files = ["aft*.ply"]

[[object]]
id = "juno"

[[object.epoch]]
id = "first"
date = 2026-05-18
mesh = true
files = ["juno.ply"]
"""
TURNED = (np.eye(4), perturb(np.eye(4), np.zeros(3), np.array([0.1, -0.2, 0.3, 1.0, 2.0, 0.5])))
JUNO = 'files = ["juno.ply"]'


def pair(reference: str, compared: str) -> str:
    """Return a comparison as the file declares it."""
    return f'\n[[object.compare]]\nreference = "{reference}"\ncompared = "{compared}"\n'


def relief(dent: float) -> Surface:
    """Return a wavy relief 0.3 m wide with a round dent [m], as a mesh of 5 mm with a little noise."""
    n = 61
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-0.15, 0.15, n), np.linspace(-0.15, 0.15, n), indexing="ij"))
    z = 0.02 * np.sin(23 * x) * np.cos(19 * y) + 0.008 * np.sin(41 * y + 17 * x)
    z = z - dent * 0.5 * (1 + np.cos(np.pi * np.minimum(np.hypot(x - 0.04, y) / 0.05, 1)))
    z = z + np.random.default_rng(round(1e5 * dent)).normal(0, 5e-5, n * n)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n - 1), np.arange(n - 1), indexing="ij"))
    a, b = i * n + j, (i + 1) * n + j
    return Surface(np.column_stack([x, y, z]), np.concatenate([np.c_[a, b, b + 1], np.c_[a, b + 1, a + 1]]))


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a campaign's file and the meshes that it names."""
    folder = tmp_path_factory.mktemp("campaign")
    (folder / "box.json").write_text('{"box": {"min": [-1, -1, -1], "max": [1, 1, 1]}}')
    for name, dent in (("before", 0.0), ("after", 0.003), ("juno", 0.001)):
        write_ply_mesh(folder / f"{name}.ply", relief(dent))
    (folder / "two.poses").write_text(
        "".join(f"{name}.ply 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n" for name in ("juno", "jun"))
    )
    (folder / "campaign.toml").write_text(CAMPAIGN)
    return folder


@pytest.fixture(scope="module")
def done(survey: Path) -> Path:
    """Return the folder after the campaign was run."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pictures, "LARGEST", 200)
        patch.setattr(pictures, "CLOSE_UP_PIXELS", 200)
        assert run(["run", str(survey / "campaign.toml")]) == 0
    return survey


def test_everything_that_the_file_declares_is_there_afterwards(done: Path) -> None:
    project = Project.open(done / "project")
    assert (project.name, project.crs) == ("Attic", "EPSG:31256")
    minerva = project.object("minerva")
    assert (minerva.name, minerva.material, minerva.tolerance) == ("Minerva", "marble", 0.002)
    assert (minerva.front, project.object("juno").front) == (np.pi, None)
    assert [(e.epoch_id, e.date.isoformat(), e.label) for e in project.epochs("minerva")] == [
        ("before", "2025-05-12", ""), ("after", "2026-05-18", "after the restoration"),
    ]  # fmt: skip
    row = project.get("minerva", "after", "comparison-before").regions.iloc[0]
    assert row["kind"] == "lost"
    assert -0.0031 < row["extreme_m"] < -0.0025  # the 95 % quantile of a bowl 3 mm deep
    out = done / "out"
    assert {p.name for p in (out / "reports").iterdir()} == {
        f"minerva_before_after_report.{k}" for k in ("html", "pdf")
    }
    assert {"juno_first_surface.ply", "juno_first_surface.csv", "minerva_before_after_on-compared.ply"} <= {
        p.name for p in (out / "files").iterdir()
    }
    assert verify_bag(out / "archive").ok
    assert (out / "archive" / "data" / "juno" / "first").is_dir()


def test_run_again_it_makes_nothing_new_and_a_file_that_grew_adds_only_that(
    done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(pictures, "LARGEST", 200)
    monkeypatch.setattr(pictures, "CLOSE_UP_PIXELS", 200)
    copy = Path(shutil.copytree(done, tmp_path / "copy"))
    made = {p: p.stat().st_mtime_ns for p in (*copy.rglob("project/**/*.h5"), *copy.rglob("*_report.*"))}
    assert {p.suffix for p in made} == {".h5", ".html", ".pdf"}
    (copy / "campaign.toml").write_text(CAMPAIGN.replace("Minerva", "Athena"))
    assert run(["run", str(copy / "campaign.toml")]) == 0
    assert {p: p.stat().st_mtime_ns for p in made} == made
    told = capsys.readouterr()
    assert "is there already and stays as it was" in told.err
    assert "1 report of minerva up to date" in told.out
    assert "mind: object minerva keeps the name 'Minerva' of when it was added; 'Athena' is not taken over" in told.err
    grown = '\n[[object.epoch]]\nid = "second"\ndate = 2027-05-18\nmesh = true\nfiles = ["after.ply"]\n'
    (copy / "campaign.toml").write_text(CAMPAIGN + grown)
    assert run(["run", str(copy / "campaign.toml")]) == 0
    assert [e.epoch_id for e in Project.open(copy / "project").epochs("juno")] == ["first", "second"]
    assert (copy / "out" / "reports" / "juno_first_second_report.pdf").exists()


def test_another_front_is_taken_over_draws_reports_anew_and_computes_nothing(
    done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(pictures, "LARGEST", 200)
    monkeypatch.setattr(pictures, "CLOSE_UP_PIXELS", 200)
    copy = Path(shutil.copytree(done, tmp_path / "copy"))
    made = {p: p.stat().st_mtime_ns for p in copy.rglob("project/objects/**/*.h5")}
    report = copy / "out" / "reports" / "minerva_before_after_report.html"
    assert "it faces south (180 degrees" in report.read_text(encoding="utf-8")
    (copy / "campaign.toml").write_text(CAMPAIGN.replace('front = "south"', "front = 45"))
    assert run(["run", str(copy / "campaign.toml")]) == 0
    told = capsys.readouterr().out
    assert (
        "the front of object minerva faces north-east (45 degrees clockwise from +y) from now on; it faced south"
        in told
    )
    assert Project.open(copy / "project").object("minerva").front == pytest.approx(np.pi / 4, abs=1e-15)
    assert "it faces north-east (45 degrees" in report.read_text(encoding="utf-8")
    assert {p: p.stat().st_mtime_ns for p in copy.rglob("project/objects/**/*.h5")} == made
    (copy / "campaign.toml").write_text(CAMPAIGN.replace('front = "south"', ""))
    assert run(["run", str(copy / "campaign.toml")]) == 0
    assert "1 report of minerva up to date" in capsys.readouterr().out
    assert Project.open(copy / "project").object("minerva").front == pytest.approx(np.pi / 4, abs=1e-15)


def test_an_object_that_fails_is_named_and_the_others_are_done(
    survey: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(pictures, "LARGEST", 200)
    monkeypatch.setattr(pictures, "CLOSE_UP_PIXELS", 200)
    for path in survey.glob("*.*"):
        shutil.copy(path, tmp_path)
    (tmp_path / "juno.ply").write_bytes(b"ply\nnot a mesh\n")
    head = CAMPAIGN.split("[[object]]")
    (tmp_path / "campaign.toml").write_text("[[object]]".join([head[0], head[2], head[1]]).replace("archive", "#"))
    assert run(["run", str(tmp_path / "campaign.toml")]) == 2
    told = capsys.readouterr().err
    assert "1 of 2 objects failed (juno), for what is said above; the others are done" in told
    assert "monitor: juno: " in told
    assert (tmp_path / "out" / "reports" / "minerva_before_after_report.pdf").exists()


@pytest.mark.parametrize("pairs", ["", pair("lost", "last") + pair("first", "last")])
def test_an_epoch_that_cannot_be_read_does_not_keep_the_others_of_its_object_from_it(
    survey: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], pairs: str
) -> None:
    """The epochs after it were not added, and those before it neither processed nor compared."""
    for path in survey.glob("*.ply"):
        shutil.copy(path, tmp_path)
    (tmp_path / "lost.ply").write_bytes(b"ply\nnot a mesh\n")
    days = {"first": "before", "lost": "lost", "last": "after"}
    epochs = "".join(
        f'[[object.epoch]]\nid = "{name}"\ndate = {2020 + k}-01-01\nmesh = true\nfiles = ["{file}.ply"]\n'
        for k, (name, file) in enumerate(days.items())
    )
    (tmp_path / "campaign.toml").write_text(f'project = "project"\n[[object]]\nid = "juno"\n{epochs}{pairs}')
    assert run(["run", str(tmp_path / "campaign.toml")]) == 2
    told = [line for line in capsys.readouterr().err.splitlines() if line.startswith("monitor: ")]
    assert len(told) == 2
    assert told[0].startswith("monitor: juno: ")
    assert "lost.ply: its header" in told[0]
    assert "1 of 1 objects failed (juno), for what is said above; what else could be done of juno is, and" in told[1]
    project = Project.open(tmp_path / "project")
    assert [e.epoch_id for e in project.epochs("juno")] == ["first", "last"]
    assert project.latest("juno", "last", "comparison-first") is not None


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('id = "juno"', 'id = "juno"\nextend = "box.json"', "object juno.extend is not known; is extent meant?"),
        ("tolerance = 2", 'tolerance = "two"', "object minerva.tolerance is 'two'; a number is needed"),
        ("tolerance = 2", "tolerance = true", "object minerva.tolerance is True; a number is needed"),
        ("tolerance = 2", "tolerance = -2", "tolerance -2.0: a length above 0 mm is needed"),
        ('"south"', '"up"', "campaign.toml: object minerva.front up: north, east, south, west are allowed"),
        ('"south"', "-90", "object minerva.front -90: north"),
        ('"south"', "true", "object minerva.front is True; the name of a side or a number of degrees is needed"),
        ('"juno.ply"', '"jun?.ply", "none-*.ply"', "epoch first.files: there is no file"),
        ('files = ["juno.ply"]', 'files = "juno.ply"', "files is 'juno.ply'; a list of files is needed"),
        ("box.json", "bax.json", "object minerva.extent: there is no file"),
        ("2025-05-12", '"12 May"', "--date 12 May: a date like 2026-05-31 is needed"),
        ('id = "juno"', 'id = "minerva"', "object minerva is declared twice"),
        ('id = "after"', 'id = "before"', "epoch of minerva before is declared twice"),
        ('project = "project"', "", "project is missing"),
        ('formats = "ply,csv"', 'formats = "dxf"', "--format dxf: allowed are"),
        ('name = "Attic"', "name = Attic", "is not TOML"),
        ('id = "juno"', 'id = "ju no"', "OBJECT id 'ju no' holds"),
        ("2025-05-12", '"12 May"', "campaign.toml: object minerva.epoch before: --date 12 May"),
        ('name = "Attic"', f"name = {'[' * 5000}{']' * 5000}", "campaign.toml: is nested too deeply"),
        ('files = ["juno.ply"]', 'poses = "box.json"\nfiles = ["juno.ply"]', "epoch first: --mesh and --poses exclude"),
        (
            'files = ["juno.ply"]',
            'files = ["juno.ply", "after.ply"]',
            "epoch first: --mesh takes one file, 2 were given",
        ),
        (JUNO, f"{JUNO}{pair('first', 'first')}", "compare 1.reference and compared are both first"),
        (JUNO, f"{JUNO}{2 * pair('a', 'b')}", "comparison of juno a and b is declared twice"),
        (
            JUNO,
            f"{JUNO}{pair('frist', 'second')}",
            "object juno is to be compared at epoch frist, which there is not; is",
        ),
        ('report = "out/reports"', 'report = "box.json"', "box.json is a file; another folder is needed"),
        ('name = "Attic"', 'name = "Attic\\u202e"', "the name of the project, 'Attic\\u202e', holds U+202E"),
        ('name = "Minerva"', 'name = "Mi\\u200bnerva"', "the name of object minerva, 'Mi\\u200bnerva', holds U+200B"),
        ("after the restoration", "after\\nthe", "the label of epoch after, 'after\\nthe', holds U+000A"),
        ('archive = "out/archive"', 'archive = "juno.ply"', "juno.ply is a file; another folder is needed"),
        ('archive = "out/archive"', 'archive = "project/archive"', "lie within each other"),
        ('export = "out/files"', 'export = "juno.ply/files"', "juno.ply is a file; another folder is needed"),
        ("tolerance = 2", f"tolerance = 2{'0' * 400}", "object minerva.tolerance is too large for a number"),
        (f"mesh = true\n{JUNO}", f'poses = "two.poses"\n{JUNO}', "epoch first: poses: jun.ply is none of the files"),
        ('report = "out/reports"', 'report = "project/reports"', "project/reports lies within the project"),
        ('archive = "out/archive"', 'archive = "out"', "reports and archive"),
        ('archive = "out/archive"', 'archive = "."', "lie within each other"),
    ],
)
def test_what_is_wrong_in_the_file_is_said_before_anything_is_done(
    survey: Path, tmp_path: Path, old: str, new: str, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in survey.glob("*.*"):
        shutil.copy(path, tmp_path)
    assert old in CAMPAIGN
    (tmp_path / "campaign.toml").write_text(CAMPAIGN.replace(old, new))
    assert run(["run", str(tmp_path / "campaign.toml")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert told in line
    assert not (tmp_path / "project").exists()


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("2025-05-12", "2025-05-13", "is in the project with the date 2025-05-12, not 2025-05-13"),
        ('"before.ply"', '"juno.ply"', "is in the project with other files"),
        ("tolerance = 2", "tolerance = 3", "is in the project with the tolerance 0.002 m, not 0.003 m"),
        ('extent = "box.json"', "", "is in the project with the extent"),
        ("31256", "31257", "has the reference system EPSG:31256, not EPSG:31257"),
        ('id = "first"', 'id = "first"\nscanner = "phase-2020"', "with the scanner not named, not phase-2020"),
        ('id = "first"', 'id = "first"\nunit = "mm"', "is in the project with a unit of 1.0 m, not 0.001 m"),
        ('id = "first"', 'id = "first"\ncontrol = "control.csv"', "is in the project with other control points"),
        ('mesh = true\nfiles = ["juno.ply"]', JUNO, "its files as a finished mesh, which the file no longer says"),
    ],
)
def test_a_file_that_contradicts_the_project_is_refused(
    done: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, told: str
) -> None:
    (done / "control.csv").write_text("name,x,y,z\nK1,0,0,0\n")
    changed = done / "changed.toml"
    assert old in CAMPAIGN
    changed.write_text(CAMPAIGN.replace(old, new))
    assert run(["run", str(changed)]) == 2
    assert told in capsys.readouterr().err


def test_paths_that_begin_at_home_do_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home, folder = tmp_path / "home", tmp_path / "campaign"
    for place in (home / "scans", folder):
        place.mkdir(parents=True)
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setenv("USERPROFILE", str(home))
    write_ply_mesh(home / "scans" / "after-1.ply", relief(0.0))
    write_ply_mesh(folder / "~juno.ply", relief(0.0))
    declared = CAMPAIGN.replace('extent = "box.json"', "").replace('"before.ply"', '"~/scans/after-1.ply"')
    declared = declared.replace('"project"', '"~/project"').replace('"aft*.ply"', '"~/scans/aft*.ply"')
    declared = declared.replace('"out/reports"', '"~/reports"').replace('"juno.ply"', '"~juno.ply"')
    (folder / "campaign.toml").write_text(declared)
    campaign = read_campaign(folder / "campaign.toml")
    assert (campaign.project, campaign.report) == (home / "project", home / "reports")
    assert campaign.export == folder / "out/files"
    (before, after), (juno,) = (declared.epochs for declared in campaign.objects)
    assert before.files == after.files == (home / "scans" / "after-1.ply",)
    assert juno.files == (folder / "~juno.ply",)


def test_other_poses_than_an_epoch_was_added_with_are_seen() -> None:
    headers = [
        ScanHeader(k, f"a.e57#{k + 1}", TURNED[k], np.zeros(3), 9, {}, None, "a.e57", "", k, False, np.zeros((2, 3)))
        for k in range(2)
    ]
    assert _are_same_poses(headers, {})
    assert _are_same_poses(headers, {f"a.e57#{k + 1}": PoseLine(TURNED[k]) for k in range(2)})
    assert not _are_same_poses(headers, {"a.e57#1": PoseLine(TURNED[1])})
    assert not _are_same_poses(headers, {"a.e57#2": PoseLine(TURNED[1], np.array([0.0, 0.0, 1e-3]), True)})
    nudged = TURNED[1] + 1e-6 * np.eye(4, k=3)  # a micrometre along x
    assert not _are_same_poses(headers, {"a.e57#2": PoseLine(nudged)})


def test_the_guide_s_example_is_a_campaign(tmp_path: Path) -> None:
    guide = (Path(__file__).resolve().parents[3] / "docs" / "campaign.md").read_text(encoding="utf-8")
    (tmp_path / "campaign.toml").write_text(guide.split("```toml\n")[1].split("```")[0], encoding="utf-8")
    for name in ("settings.toml", "before.e57", "after-1.ply", "after-2.ply"):
        (tmp_path / name).touch()
    for name in ("minerva-box.json", "pedestal.json"):
        (tmp_path / name).write_text('{"box": {"min": [-1, -1, -1], "max": [1, 1, 1]}}')
    (tmp_path / "after.poses").write_text("after-1.ply 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n")
    campaign = read_campaign(tmp_path / "campaign.toml")
    minerva = campaign.objects[0]
    assert [len(e.files) for e in minerva.epochs] == [1, 2]
    assert minerva.record.front == np.pi
    anywhere = (tmp_path / "campaign.toml").read_text().replace('"after-*.ply"', f'"{tmp_path.as_posix()}/after-?.ply"')
    (tmp_path / "campaign.toml").write_text(anywhere)
    assert read_campaign(tmp_path / "campaign.toml").objects[0].epochs[1].files == minerva.epochs[1].files
    elsewhere = tmp_path / "survey [2024] *"  # what a pattern would match is a folder's name
    elsewhere.mkdir()
    for path in [p for p in tmp_path.iterdir() if p.is_file()]:
        shutil.copy(path, elsewhere)
    again = read_campaign(elsewhere / "campaign.toml").objects[0].epochs[1].files
    assert [p.name for p in again] == ["after-1.ply", "after-2.ply"]
    assert (minerva.epochs[0].scanner, minerva.epochs[0].date) == ("phase-2020", "2025-05-12")
    (pair,) = minerva.pairs
    assert (pair.mode, pair.stable) == ("relative", tmp_path / "pedestal.json")
