"""A bag that is no longer whole says what it lacks, and by which file."""

from pathlib import Path

import pytest

from monitor.cli import run
from projects.bags import verify_bag, write_bag


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Return a bag of two files."""
    folder = tmp_path / "bag"
    (folder / "data").mkdir(parents=True)
    (folder / "data" / "a.txt").write_text("a")
    (folder / "data" / "b.txt").write_text("b")
    write_bag(folder, {"External-Identifier": "x"})
    assert verify_bag(folder).findings == ()
    return folder


def test_a_bag_that_lost_its_declaration_is_still_one_and_it_is_said_what_that_holds(
    bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lost = (bag / "bagit.txt").read_text()
    (bag / "bagit.txt").unlink()
    assert run(["verify", str(bag)]) == 2
    told = capsys.readouterr()
    assert "error: bagit.txt: bagit.txt is missing: restore it from a copy, or write it anew" in told.out
    assert "monitor init" not in told.err
    assert all(repr(line) in told.out for line in lost.splitlines())
    (bag / "bagit.txt").write_text(lost)
    assert run(["verify", str(bag)]) == 0


@pytest.mark.parametrize("place", ["moved", "../moved"])
@pytest.mark.parametrize("name", ["data/a.txt", "bag-info.txt"])
def test_a_link_in_the_place_of_a_file_is_an_error_though_it_leads_to_the_same_bytes(
    bag: Path, name: str, place: str
) -> None:
    elsewhere = (bag / place).resolve()
    (bag / name).rename(elsewhere)
    (bag / name).symlink_to(elsewhere)
    (finding,) = verify_bag(bag).findings
    assert (finding.severity, finding.path) == ("error", name)
    assert finding.message == f"{name} is a symbolic link; put the file itself there, then verify again"
