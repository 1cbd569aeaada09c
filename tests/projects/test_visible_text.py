"""Names and labels hold nothing that is not seen where they are shown: refused in one line, nothing is kept."""

import datetime

import pytest

from projects import Project
from projects.errors import ParameterError
from projects.model import EpochRecord, ObjectRecord
from projects.visible_text import require_visible


@pytest.mark.parametrize("unseen", ["\u202e", "\u2066", "\u200b", "\u00ad", "\ufeff", "\x1b", "\x00", "\n", "\u2028"])
def test_a_name_or_label_with_a_character_that_is_not_seen_is_refused_in_one_clear_line(tmp_path, unseen):
    text = f"Kopf {unseen}1890"
    with pytest.raises(ParameterError, match="the name of project p, 'Kopf "):
        Project.create(tmp_path / "p", name=text)
    assert not (tmp_path / "p").exists()
    project = Project.create(tmp_path / "p")
    for field in ("name", "inventory", "place", "material"):
        with pytest.raises(ParameterError, match=f"the {field} of object head, 'Kopf ") as caught:
            project.add_object(ObjectRecord("head", **{field: text}))
        told = str(caught.value)
        assert told.isprintable()
        assert f"U+{ord(unseen):04X}" in told
    assert project.objects() == []
    project.add_object(ObjectRecord("head"))
    for field in ("label", "operator"):
        with pytest.raises(ParameterError, match=f"the {field} of epoch e1, 'Kopf "):
            project.add_epoch(EpochRecord("head", "e1", datetime.date(2026, 5, 1), **{field: text}))
    assert project.epochs("head") == []


def test_the_character_is_named_in_words():
    with pytest.raises(ParameterError, match=r"holds U\+202E \(right-to-left override\), which is not seen"):
        require_visible(ObjectRecord("head", name="a\u202eb"), "object head")
    with pytest.raises(ParameterError, match=r"holds U\+0007 \(a control character\)"):
        require_visible(ObjectRecord("head", description="a\x07b"), "object head")


def test_texts_of_all_scripts_are_taken_and_a_description_may_have_lines(tmp_path):
    names = ("Säule am Tor – „Kopf“ № 3", "راس می\u200cخواهم", "ראש אבן", "石の頭", "क्\u200dष", "5\u00a0mm", "e\u0301")
    project = Project.create(tmp_path / "p")
    for k, name in enumerate(names):
        project.add_object(ObjectRecord(f"head-{k}", name=name, description=f"{name}\n\t{name}\r\n"))
        kept = project.object(f"head-{k}")
        assert (kept.name, kept.description) == (name, f"{name}\n\t{name}\r\n")
