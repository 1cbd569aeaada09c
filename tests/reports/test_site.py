"""The local pages of a project: what it holds, from this machine alone, and only to be read."""

import dataclasses
import datetime
import io
import threading
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from example_project import fill, step
from PIL import Image
from report_examples import example_comparison, example_object
from series_examples import followed

from monitor.cli.serving import open_server
from projects import Project
from projects.errors import ParameterError
from projects.model import EpochRecord
from reports import pictures
from reports.cameras import choose_one
from reports.site import Site

CHROMIUM = Path("/usr/bin/chromium")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """Return the pages of the example project, its pictures small."""
    with pytest.MonkeyPatch.context() as small:
        small.setattr(pictures, "LARGEST", 120)
        small.setattr(pictures, "CLOSE_UP_PIXELS", 120)
        yield Site(fill(tmp_path_factory.mktemp("site")).path)


def ask(site: Site, address: str, **more: str) -> tuple[str, dict[str, str], bytes]:
    """Return status, headers and content of what a browser on this machine gets."""
    got: dict[str, Any] = {}

    def start(status: str, headers: list[tuple[str, str]]) -> None:
        got.update(status=status, headers=dict(headers))

    environ = {"REQUEST_METHOD": "GET", "HTTP_HOST": "127.0.0.1:8000", "PATH_INFO": address, **more}
    content = b"".join(site(environ, start))
    return got["status"], got["headers"], content


def page(site: Site, address: str) -> str:
    """Return a page that must be there."""
    status, _, content = ask(site, address)
    assert status == "200 OK"
    return content.decode("utf-8")


def test_the_first_page_names_every_object_with_what_was_found_last(site: Site) -> None:
    text = page(site, "/")
    for told in ("Tor", 'href="/column"', "Säule am Tor", "Garden", "12\u00a0May\u00a02025"):
        assert told in text


def test_what_was_found_last_is_told_with_the_days_that_it_is_about(tmp_path: Path) -> None:
    """The latest epoch is not compared yet: nothing is known of it."""
    project = fill(tmp_path)
    project.add_epoch(
        EpochRecord("column", "e3", datetime.date(2027, 6, 1)), mesh=example_comparison().on_compared.surface
    )
    text = page(Site(project.path), "/").replace("\u00a0", " ")
    assert "12 May 2025, 18 May 2026, 1 June 2027" in text
    assert "12 May 2025 to 18 May 2026: Two regions changed." in text


def test_an_object_s_page_tells_its_comparisons_and_epochs(site: Site) -> None:
    text = page(site, "/column")
    assert text.index("Two regions changed.") < text.index("Epochs") < text.index("K 12/3")
    assert "2 scans, 800 points" in text
    assert "finished mesh" in text
    for address in ("/column/e1.jpg", "/column/e2.jpg", "/column/e1_e2.jpg", "/column/e1_e2.html", "/column/e1_e2.pdf"):
        assert f'"{address}"' in text
        assert ask(site, address)[0] == "200 OK"
    assert ask(site, "/column/e1_e2.pdf")[2].startswith(b"%PDF-1.7")
    assert "The record" in page(site, "/column/e1_e2.html")


def test_the_picture_of_a_comparison_shows_its_change(site: Site) -> None:
    _, headers, content = ask(site, "/column/e1_e2.jpg")
    assert headers["Content-Type"] == "image/jpeg"
    picture = np.asarray(Image.open(io.BytesIO(content)).convert("RGB"), dtype=int)
    warm = (picture[..., 0] - picture[..., 2] > 60).sum()
    stone = np.asarray(Image.open(io.BytesIO(ask(site, "/column/e1.jpg")[2])).convert("RGB"), dtype=int)
    assert warm > 200
    assert (stone[..., 0] - stone[..., 2] > 60).sum() == 0


def test_each_picture_of_a_comparison_has_its_own_legend_beside_it(site: Site) -> None:
    """Colours end where each comparison's own do, and several stand on one page."""
    text = page(site, "/column")
    assert text.index('"/column/e1_e2.jpg"') < text.index('"/column/e1_e2.svg"') < text.index("another’s")
    _, headers, content = ask(site, "/column/e1_e2.svg")
    assert headers["Content-Type"] == "image/svg+xml"
    for word in ("lost", "gained", "change [mm]", "+15", "unchanged", "not assessable"):
        assert word in content.decode("utf-8"), word


def test_the_one_view_is_that_which_shows_what_is_wanted() -> None:
    side = example_comparison().on_compared
    dent, patch = (choose_one(side.surface, side.region == n).towards for n in (1, 2))
    assert dent @ (0, -1, 0) > 0.9
    assert patch @ (1, 0, 0) > 0.9
    nothing = np.zeros(len(side.region), bool)
    assert choose_one(side.surface, nothing).name == "front"
    back = dataclasses.replace(side.surface, vertices=side.surface.vertices * (1.0, -1.02, 1.0),
                               faces=side.surface.faces[:, ::-1])  # fmt: skip
    assert choose_one(back, nothing).name == "front"  # whatever side shows a little more


def test_what_is_not_there_is_said_and_nothing_else_is_shown(site: Site) -> None:
    for address in ("/nobody", "/column/e9.jpg", "/column/e2_e1.html", "/column/e1.html", "/../etc/passwd",
                    "/column/..%2f..%2fproject.h5", "/column/e1_e2.h5", "/a/b/c", "/%00"):  # fmt: skip
        status, headers, content = ask(site, address)
        assert status == "404 Not Found", address
        assert headers["Content-Type"].startswith("text/plain")
        assert len(content.splitlines()) == 1


def test_only_this_machine_reads_and_nobody_writes(site: Site) -> None:
    assert ask(site, "/", HTTP_HOST="evil.example:8000")[0] == "403 Forbidden"
    assert ask(site, "/", HTTP_HOST="127.0.0.1.evil.example")[0] == "403 Forbidden"
    for local in ("localhost:1", "localhost", "[::1]", "[::1]:8000"):
        assert ask(site, "/", HTTP_HOST=local)[0] == "200 OK"
    assert ask(site, "/", REQUEST_METHOD="POST")[0] == "405 Method Not Allowed"
    status, headers, content = ask(site, "/", REQUEST_METHOD="HEAD")
    assert (status, content) == ("200 OK", b"")
    assert "default-src 'none'" in headers["Content-Security-Policy"]


def test_hostile_texts_are_shown_and_never_run(tmp_path: Path) -> None:
    project = Project.create(tmp_path / "p", name="<script>alert(1)</script>", description="<img src=x>")
    project.add_object(example_object(name="</style><script>x</script>", place="{{ 7*7 }}"))
    for address in ("/", "/column"):
        text = page(Site(project.path), address)
        assert "<script" not in text
        assert "&lt;script&gt;" in text
    assert "{{ 7*7 }}" in page(Site(project.path), "/")
    assert "No two epochs are compared yet." in page(Site(project.path), "/column")


def test_a_page_shows_what_was_made_since(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "LARGEST", 120)
    monkeypatch.setattr(pictures, "CLOSE_UP_PIXELS", 120)
    project = fill(tmp_path)
    site = Site(project.path)
    assert "processed again" not in page(site, "/column")
    assert "processed again" not in page(site, "/column/e1_e2.html")
    project.put("column", "e2", step("surface", "6"), example_comparison().on_compared.surface)
    assert "Epoch e2 was processed again after this comparison" in page(site, "/column")
    assert "Epoch e2 was processed again after this comparison" in page(site, "/column/e1_e2.html")
    project.put("column", "e2", step("comparison-e1", "7", inputs=("3" * 16, "6" * 16)),
                example_comparison(rows=(), n_not_assessable=0, n_unchanged=1, n_changed=0))  # fmt: skip
    text = page(site, "/column")
    assert "processed again" not in text
    assert "Two regions changed." not in text


def test_an_object_s_page_says_what_must_be_known_first(tmp_path: Path) -> None:
    project = fill(tmp_path)
    backwards = example_comparison(n_not_assessable=0, n_unchanged=1, n_changed=1)
    project.put("column", "e1", step("comparison-e2", "8", inputs=("3" * 16, "4" * 16)), backwards)
    text = page(Site(project.path), "/column")
    assert "Told backwards in time: epoch e2 of" in text
    assert "What is called lost was gained since, and what is called gained was lost." in text


def test_a_damaged_comparison_hides_neither_its_object_nor_the_others(tmp_path: Path) -> None:
    project = fill(tmp_path)
    project.add_object(dataclasses.replace(example_object(name="Brunnen"), object_id="fountain"))
    (kept,) = project.path.rglob("comparison-e1-*.h5")
    damaged = bytearray(kept.read_bytes())
    damaged[len(damaged) // 2] ^= 0xFF
    kept.write_bytes(damaged)
    front, own = page(Site(project.path), "/"), page(Site(project.path), "/column")
    assert "Brunnen" in front
    assert "cannot be shown: column e2 comparison-e1" in front
    assert "The comparison of e1 and e2 cannot be shown: column e2 comparison-e1: the bytes of" in own
    assert "/column/e1.jpg" in own
    assert ask(Site(project.path), "/column/e1_e2.html")[0] == "404 Not Found"


def test_the_server_answers_on_this_machine_and_a_port_in_use_is_refused(site: Site) -> None:
    with open_server(site.path, 0) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        with urllib.request.urlopen(f"http://127.0.0.1:{server.server_port}/", timeout=30) as reply:
            assert "Säule am Tor" in reply.read().decode("utf-8")
        with pytest.raises(ParameterError, match=r"--port [0-9]+: cannot be used .*; leave it out"):
            open_server(site.path, server.server_port)
        server.shutdown()


def test_a_browser_that_went_away_is_no_error_and_any_other_is_told(
    site: Site, capsys: pytest.CaptureFixture[str]
) -> None:
    with open_server(site.path, 0) as server:
        for error, told in ((ConnectionResetError("gone"), ""), (ValueError("ours"), "ValueError: ours")):
            try:
                raise error
            except (ConnectionResetError, ValueError):
                server.handle_error(None, ("127.0.0.1", 1))
            said = capsys.readouterr().err
            assert told in said
            assert bool(said) == bool(told)


@pytest.mark.page
def test_a_browser_shows_every_picture_of_an_object(site: Site) -> None:
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if not CHROMIUM.exists():
        pytest.skip(f"no browser at {CHROMIUM}")
    complaints: list[str] = []
    with open_server(site.path, 0) as server, playwright.sync_playwright() as p:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        browser = p.chromium.launch(executable_path=str(CHROMIUM), args=["--no-sandbox"])
        tab = browser.new_page(viewport={"width": 1280, "height": 900})
        tab.on("console", lambda message: complaints.append(message.text))
        tab.goto(f"http://127.0.0.1:{server.server_port}/")
        tab.click("text=Säule am Tor")
        tab.wait_for_load_state("networkidle")
        images = tab.evaluate("[...document.images].map(i => [i.complete, i.naturalWidth, i.alt.length])")
        wide = tab.evaluate("document.documentElement.scrollWidth")
        browser.close()
        server.shutdown()
    assert len(images) == 4
    assert all(complete and width > 100 and alt > 0 for complete, width, alt in images)
    assert wide <= 1280
    assert complaints == []


def test_the_one_view_goes_by_the_front_that_was_given() -> None:
    side = example_comparison().on_compared
    dent = choose_one(side.surface, side.region == 1, 0.0)
    assert dent.name == "back"
    np.testing.assert_allclose(dent.towards, [0.0, -1.0, 0.0], atol=1e-11)
    np.testing.assert_allclose(choose_one(side.surface, bearing=np.pi / 2).towards, [1.0, 0.0, 0.0], atol=1e-11)


def test_pages_follow_a_front_that_is_given_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the two regions the dent is at -y, which becomes the back."""
    monkeypatch.setattr(pictures, "LARGEST", 120)
    monkeypatch.setattr(pictures, "CLOSE_UP_PIXELS", 120)
    project = fill(tmp_path)
    site = Site(project.path)
    asked = ("/column/e1.jpg", "/column/e1_e2.jpg", "/column/e1_e2.html")
    before = {address: ask(site, address)[2] for address in asked}
    assert "front, 70" in before[asked[2]].decode()
    assert "(front, 70" in page(site, "/column")
    Project.open(project.path).set_front("column", np.radians(15.0))
    own = page(site, "/column")
    assert "faces north (15 degrees" in own
    assert "(back, 70" in own
    told = page(site, asked[2])
    assert "back, 70" in told
    assert "front, 70" not in told
    for picture in asked[:2]:
        assert ask(site, picture)[2] != before[picture]  # from a view that is turned with the front


def test_an_object_s_page_tells_what_was_followed_through_time_and_leads_to_it(tmp_path: Path) -> None:
    """The longest series of a reference, with its days; one that rests on comparisons made anew is none."""
    project = fill(tmp_path)
    assert "Through time" not in page(Site(project.path), "/column")
    compared = example_comparison(n_not_assessable=0, n_unchanged=1, n_changed=1)
    project.add_epoch(EpochRecord("column", "e3", datetime.date(2027, 5, 18)), mesh=compared.on_compared.surface)
    project.put("column", "e3", step("surface", "4"), compared.on_compared.surface)
    project.put("column", "e3", step("comparison-e1", "6", inputs=("3" * 16, "4" * 16)), compared)
    series = dataclasses.replace(followed({5: 2}), reference_id="e1", reference_date="2025-05-12",
                                 epoch_ids=("e2", "e3"), dates=("2026-05-18", "2027-05-18"))  # fmt: skip
    project.put("column", "e3", step("series-e1", "7", inputs=("5" * 16, "6" * 16)), series)
    text = page(Site(project.path), "/column").replace("\u00a0", " ")
    told = text[text.index("Through time") : text.index("<h2>Epochs")]
    assert "12 May 2025, 18 May 2026, 18 May 2027" in told
    assert "Three epochs from 12 May 2025 to 18 May 2027. One region is followed" in told
    assert 'href="/column/e1_e3.html#series"' in told
    assert 'href="/column/e1_e3.pdf"' in told
    project.put("column", "e2", step("comparison-e1", "8", inputs=("3" * 16, "4" * 16)), compared)
    assert "Through time" not in page(Site(project.path), "/column")
