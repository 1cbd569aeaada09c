"""Reference systems: which a project may have, how LAS and E57 name one, and files whose coordinates are no metres."""

import laspy
import numpy as np
import pytest
from pyproj import CRS

from monitor.cli import run
from projects import Project, Scan
from projects.errors import ParameterError, UnitError
from projects.formats import read_scans, write_e57, write_las
from projects.formats.units import question_system
from projects.model import ObjectRecord, PointCloud
from projects.reference_systems import (
    ReferenceSystem,
    describe_system,
    name_of_plane,
    read_wkt,
    require_projected_metres,
    wkt_of,
)

AUSTRIA, UTM, FEET, DEGREES = "EPSG:31256", "EPSG:25833", "EPSG:2263", "EPSG:4326"


@pytest.fixture
def cloud(rng):
    return PointCloud(rng.normal((2_000.0, 341_000.0, 170.0), 1.0, (500, 3)))


@pytest.mark.parametrize(("code", "plane"), [(AUSTRIA, AUSTRIA), (UTM, UTM), ("EPSG:5834", "EPSG:5684")])
def test_projected_systems_in_metres_are_taken_with_heights_or_without(tmp_path, code, plane):
    assert run(["init", str(tmp_path / "p"), "--crs", code]) == 0
    assert Project.open(tmp_path / "p").crs == code
    assert name_of_plane(code) == plane


@pytest.mark.parametrize(
    ("code", "told"),
    [
        (FEET, "EPSG:2263 (NAD83 / New York Long Island (ftUS)) has the unit US survey foot;"),
        (DEGREES, "EPSG:4326 (WGS 84) is no plane system of x and y;"),
        ("EPSG:4978", "is no plane system"),  # geocentric: metres, but z is not up
        ("EPSG:5703", "is no plane system"),  # heights alone
        ("EPSG:99999999", "EPSG:99999999 is not in the EPSG register;"),
        ("EPSG:\u0663", "a projected system in metres of the EPSG register is needed, like EPSG:31256"),
        ("31256", "like EPSG:31256"),
    ],
)
def test_other_systems_are_refused_with_what_they_are(tmp_path, capsys, code, told):
    with pytest.raises(ParameterError) as refused:
        require_projected_metres(code)
    assert told in str(refused.value)
    assert run(["init", str(tmp_path / "p"), "--crs", code]) == 2
    assert told in capsys.readouterr().err
    assert not (tmp_path / "p").exists()


def test_a_file_s_system_is_that_of_its_horizontal_part():
    assert describe_system(CRS("EPSG:9897")) == ReferenceSystem("EPSG:2169", "metre", 1.0)
    feet = describe_system(CRS(FEET))
    assert (feet.name, feet.unit) == (FEET, "US survey foot")
    assert feet.metres == pytest.approx(1200 / 3937, rel=1e-12)
    assert describe_system(CRS(DEGREES)) == ReferenceSystem(DEGREES, "degree", None)
    local = read_wkt('LOCAL_CS["site grid",UNIT["foot",0.3048]]')
    assert local == ReferenceSystem("site grid", "foot", 0.3048)
    assert (read_wkt(""), read_wkt("no words of OGC")) == (None, None)
    assert [wkt_of(""), name_of_plane(""), wkt_of("EPSG:99999999"), name_of_plane("nonsense")] == [""] * 4


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_las_names_its_system_for_other_programs_and_for_ours(tmp_path, cloud, suffix):
    path = tmp_path / f"a{suffix}"
    write_las(path, cloud, crs=AUSTRIA)
    header = laspy.read(path).header
    assert header.global_encoding.wkt
    assert header.parse_crs().to_json_dict()["id"] == {"authority": "EPSG", "code": 31256}
    assert header.vlrs[0].string.startswith("PROJCS[")  # WKT 1, as LAS 1.4 asks for; WKT 2 begins with PROJCRS
    (stream,) = read_scans(path)
    assert stream.system == ReferenceSystem(AUSTRIA, "metre", 1.0)
    write_las(path, cloud)
    assert laspy.read(path).header.parse_crs() is None
    (stream,) = read_scans(path)
    assert stream.system is None


def test_las_that_names_its_system_by_keys_is_read(tmp_path, cloud):
    header = laspy.LasHeader(version="1.2", point_format=0)
    header.add_crs(CRS(FEET))
    header.scales = np.full(3, 1e-4)
    las = laspy.LasData(header)
    las.x, las.y, las.z = (cloud.points - cloud.points[0]).T
    las.write(tmp_path / "a.las")
    (stream,) = read_scans(tmp_path / "a.las")
    assert stream.system == describe_system(CRS(FEET))


def test_e57_names_its_system(tmp_path, cloud):
    write_e57(tmp_path / "a.e57", [Scan("a", cloud, np.eye(4))], crs=UTM)
    write_e57(tmp_path / "b.e57", [Scan("a", cloud, np.eye(4))])
    assert [next(read_scans(tmp_path / name)).system for name in ("a.e57", "b.e57")] == [
        ReferenceSystem(UTM, "metre", 1.0),
        None,
    ]


def test_heights_in_another_unit_than_the_plane_are_questioned(tmp_path, cloud):
    mixed = describe_system(CRS("EPSG:26918+6360"))
    assert mixed == ReferenceSystem("EPSG:26918", "metre", 1.0, "US survey foot")
    told = r"^a says that its heights are in US survey foot and its plane coordinates in metre \(EPSG:26918\); bring"
    with pytest.raises(UnitError, match=told):
        question_system(mixed, False, "a")
    question_system(mixed, True, "a")
    for alike in ("EPSG:26918+5703", "EPSG:2263+6360"):
        assert not describe_system(CRS(alike)).heights
    assert describe_system(CRS("EPSG:2263+5703")).heights == "metre"
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.add_crs(CRS("EPSG:26918+6360"))
    header.scales = np.full(3, 1e-4)
    las = laspy.LasData(header)
    las.x, las.y, las.z = (cloud.points - cloud.points[0]).T
    las.write(tmp_path / "a.las")
    (stream,) = read_scans(tmp_path / "a.las")
    assert stream.system == mixed


def test_coordinates_that_are_said_to_be_no_metres_are_questioned_unless_the_user_says_what_they_are():
    feet, degrees = describe_system(CRS(FEET)), describe_system(CRS(DEGREES))
    with pytest.raises(UnitError, match=r"^a says .* in US survey foot \(EPSG:2263\); state it: --unit ft$"):
        question_system(feet, False, "a")
    with pytest.raises(UnitError, match=r"^a says .* angles \(EPSG:4326, degree\); bring them into a plane system"):
        question_system(degrees, False, "a")
    with pytest.raises(UnitError, match=r"in chain .*; state it: bring them into metres first"):
        question_system(ReferenceSystem("site", "chain", 20.1168), False, "a")
    for system in (feet, degrees):
        question_system(system, True, "a")
    question_system(describe_system(CRS(UTM)), False, "a")
    question_system(None, False, "a")


def test_an_epoch_in_feet_is_refused_and_one_in_another_system_is_told(tmp_path, capsys, cloud):
    project = Project.create(tmp_path / "p", crs=AUSTRIA)
    project.add_object(ObjectRecord(object_id="gate"))
    add = ["add-epoch", str(tmp_path / "p"), "gate", "e1", "--date", "2026-05-01"]
    header = laspy.LasHeader(version="1.2", point_format=0)
    header.add_crs(CRS(FEET))
    las = laspy.LasData(header)
    las.x, las.y, las.z = (cloud.points - cloud.points.mean(axis=0)).T
    las.write(tmp_path / "feet.las")
    assert run([*add, str(tmp_path / "feet.las")]) == 2
    assert "feet.las says that its coordinates are in US survey foot (EPSG:2263); state it: --unit ft" in " ".join(
        capsys.readouterr().err.split()
    )
    assert project.epochs("gate") == []
    write_las(tmp_path / "utm.laz", cloud, crs=UTM)
    assert run([*add, str(tmp_path / "utm.laz")]) == 0
    told = " ".join(capsys.readouterr().err.split())
    assert "mind: utm.laz: said to be in EPSG:25833, the project is in EPSG:31256; the coordinates were taken" in told
    assert [epoch.epoch_id for epoch in project.epochs("gate")] == ["e1"]


def test_one_in_the_project_s_system_is_taken_without_a_word(tmp_path, capsys, cloud):
    project = Project.create(tmp_path / "p", crs=AUSTRIA)
    project.add_object(ObjectRecord(object_id="gate"))
    write_las(tmp_path / "own.laz", cloud, crs=AUSTRIA)
    assert run(["add-epoch", str(tmp_path / "p"), "gate", "e1", "--date", "2026-05-01", str(tmp_path / "own.laz")]) == 0
    assert "said to be in" not in capsys.readouterr().err
