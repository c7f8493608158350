"""Which operands are faster: measured once, kept per machine, and never in the way."""

import json

import pytest

from ovibjax.runtime import precision_choice
from ovibjax.runtime.precision import PRECISIONS
from ovibjax.runtime.precision_choice import chosen, faster_precision, measure


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("OVIBJAX_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def times(monkeypatch):
    """What measuring gives, and a list that grows with every measurement."""
    precision_choice._kept_or_measured.cache_clear()
    seconds, asked = dict.fromkeys(PRECISIONS, 1.0), []

    def measured():
        asked.append(1)
        return seconds

    monkeypatch.setattr(precision_choice, "measure", measured)
    yield seconds, asked
    precision_choice._kept_or_measured.cache_clear()


def again():
    """What another process would be told."""
    precision_choice._kept_or_measured.cache_clear()
    return faster_precision()


def test_bfloat16_must_be_worth_it():
    assert chosen({"float32": 1.19, "bfloat16": 1.0}) == "float32"
    assert chosen({"float32": 1.2, "bfloat16": 1.0}) == "bfloat16"
    assert chosen({"float32": 1.0, "bfloat16": 3.0}) == "float32"


def test_measured_once_per_machine(cache, times, monkeypatch):
    seconds, asked = times
    seconds["float32"] = 2.0
    assert again() == faster_precision() == "bfloat16" and len(asked) == 1
    seconds["float32"] = 0.5
    assert again() == "bfloat16" and len(asked) == 1
    monkeypatch.setattr(precision_choice, "processor", lambda: "another")
    assert again() == "float32" and len(asked) == 2
    assert len(list((cache / "precision").iterdir())) == 2


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"precision": "float16"}', '{"precision": ["float32"]}'])
def test_what_is_damaged_is_measured_again(cache, times, text):
    again()
    (path,) = (cache / "precision").iterdir()
    path.write_text(text)
    times[0]["float32"] = 2.0
    assert again() == "bfloat16" and len(times[1]) == 2
    assert json.loads(path.read_text())["precision"] == "bfloat16"


def test_a_cache_that_cannot_be_written_is_no_obstacle(cache, times):
    cache.write_text("a file where the folder would be")
    assert again() == faster_precision() == "float32" and len(times[1]) == 1


def test_a_layer_is_timed():
    seconds = measure()
    assert list(seconds) == list(PRECISIONS) and all(0 < s < 60 for s in seconds.values())
