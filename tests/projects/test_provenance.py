"""Ids and records: equal questions have equal ids, and records come back as they went in."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from projects.errors import StoreError
from projects.provenance import hash_file, step_id, versions
from projects.records import canonical_json, from_json, plain, to_json

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text().filter(lambda k: k != "$float"), inner),
    max_leaves=20,
)


@dataclass(frozen=True)
class Settings:
    """Stands for the settings of a step."""

    spacing: float | None = None
    n: int = 48


def same(one, other):
    if isinstance(one, float) and isinstance(other, float):
        return one == other or (math.isnan(one) and math.isnan(other))
    if isinstance(one, list):
        return isinstance(other, list) and len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, dict):
        return isinstance(other, dict) and list(one) == list(other) and all(same(one[k], other[k]) for k in one)
    return type(one) is type(other) and one == other


@given(VALUES)
def test_record_comes_back_as_it_went_in(value):
    assert same(from_json(to_json(value)), value)


def test_numpy_and_dataclasses_become_plain():
    value = {"a": np.float32(0.5), "b": np.arange(2), "c": (1, np.bool_(True)), "d": Settings(), "e": np.float64("nan")}
    found = plain(value)
    assert math.isnan(found.pop("e"))
    assert found == {"a": 0.5, "b": [0, 1], "c": [1, True], "d": {"spacing": None, "n": 48}}
    assert type(found["a"]) is float
    assert from_json(to_json({"file": "caf\udce9.ptx"})) == {"file": "caf\udce9.ptx"}


def test_what_is_no_record_is_refused_with_its_place():
    with pytest.raises(StoreError, match="record/a/1: a object cannot be kept"):
        plain({"a": [1, object()]})
    with pytest.raises(StoreError, match="record: 3 cannot be a record's key"):
        plain({3: 1})
    with pytest.raises(StoreError, match="a damaged record"):
        from_json("{")


def test_equal_questions_have_equal_ids():
    asked = step_id("cloud", {"a": 1, "b": None}, ["x", "y"])
    assert asked == step_id("cloud", {"b": None, "a": 1.0}, ("x", "y"))
    assert step_id("cloud", Settings(), []) == step_id("cloud", {"spacing": None, "n": 48}, [])
    assert len(asked) == 16


def test_any_other_question_has_another_id():
    asked = [
        step_id("cloud", {"a": 1}, ["x", "y"]),
        step_id("surface", {"a": 1}, ["x", "y"]),
        step_id("cloud", {"a": 1.0000001}, ["x", "y"]),
        step_id("cloud", {"a": True}, ["x", "y"]),
        step_id("cloud", {"a": "1"}, ["x", "y"]),
        step_id("cloud", {"a": None}, ["x", "y"]),
        step_id("cloud", {"a": float("nan")}, ["x", "y"]),
        step_id("cloud", {"a": 1}, ["y", "x"]),
        step_id("cloud", {"a": 1}, ["xy"]),
        step_id("cloud", {"a": 1}, ["x", "y"], 2),
    ]
    assert len(set(asked)) == len(asked)


def test_id_is_that_of_the_canonical_json():
    """The id of an archived step must be found again by every later program."""
    text = '{"inputs":["00ff"],"parameters":{"n":48,"spacing":null},"product":"cloud","version":"1"}'
    assert canonical_json({"product": "cloud", "parameters": Settings(), "inputs": ["00ff"], "version": "1"}) == text
    assert step_id("cloud", Settings(), ["00ff"]) == hashlib.sha256(text.encode()).hexdigest()[:16]


def test_hash_of_a_file_is_its_sha256(tmp_path, rng):
    octets = rng.bytes(3_000_000)
    (tmp_path / "a").write_bytes(octets)
    assert hash_file(tmp_path / "a") == hashlib.sha256(octets).hexdigest()
    with pytest.raises(StoreError, match="cannot be read"):
        hash_file(tmp_path / "b")


def test_versions_name_what_computed():
    assert {"heritage-monitor", "python", "numpy", "h5py", "platform"} <= versions().keys()
    assert versions()["numpy"] == np.__version__
