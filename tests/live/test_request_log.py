"""What was written stays and is read again; what is no log is neither read nor written into."""

import json

import pytest

from ovibjax.errors import InputError
from ovibjax.live.request_log import REFUSALS_PER_S, RequestLog, read_log

START = json.dumps({"event": "start"})


def test_numbers_are_as_long_as_they_deserve(tmp_path):
    path = tmp_path / "log.jsonl"
    with RequestLog(path) as log:
        log.write("request", nothing=None, number=float("nan"), other=1.23456789, text="x", whole=3)
    assert json.loads(path.read_text()) == {
        "event": "request",
        "number": None,
        "other": 1.234568,
        "text": "x",
        "whole": 3,
    }


def test_a_log_goes_on_where_it_was_cut(tmp_path):
    path = tmp_path / "log.jsonl"
    path.write_text(START + '\n{"event": "requ')
    assert [event["event"] for event in read_log(path)] == ["start"]
    with RequestLog(path) as log:
        log.write("start")
        log.write("request")
    assert [event["event"] for event in read_log(path)] == ["start", "start", "request"]


@pytest.mark.parametrize("content", ["frame,x_m,y_m\n1,2,3", "[]\n", '{"a": 1}\n', "\xff\n"])
def test_what_is_no_log_is_left_as_it_is(content, tmp_path):
    path = tmp_path / "poses.csv"
    path.write_text(content)
    with pytest.raises(InputError, match=r"poses\.csv: not a log of ovibjax edge"):
        RequestLog(path)
    with pytest.raises(InputError, match=r"poses\.csv: line 1: no event"):
        list(read_log(path))
    assert path.read_text() == content


@pytest.mark.parametrize("middle", ["garbage", "{}", "[1]", '{"event": 3}', "[" * 10_000])
def test_a_damaged_line_is_named(middle, tmp_path):
    path = tmp_path / "log.jsonl"
    path.write_text(f'{START}\n{middle}\n{{"event": "request"}}\n')
    with pytest.raises(InputError, match=r"log\.jsonl: line 2: no event"):
        list(read_log(path))
    path.write_text(f"{START}\n{middle}\n")
    with pytest.raises(InputError, match="line 2"):
        list(read_log(path))


def test_places_that_cannot_be_used_are_named(tmp_path):
    with pytest.raises(InputError, match="the log cannot be written"):
        RequestLog(tmp_path / "none" / "log.jsonl")
    with pytest.raises(InputError, match="the log cannot be written"):
        RequestLog(tmp_path)
    with pytest.raises(InputError, match="the log cannot be read"):
        list(read_log(tmp_path / "none"))


def test_a_flood_of_refusals_is_counted(tmp_path, monkeypatch):
    path, now = tmp_path / "log.jsonl", [100.0]
    monkeypatch.setattr("ovibjax.live.request_log.time.monotonic", lambda: now[0])
    with RequestLog(path) as log:
        for _ in range(REFUSALS_PER_S + 7):
            log.refused("magic", peer="somebody")
        now[0] += 1
        log.refused("magic", peer="somebody")
    lines = list(read_log(path))
    assert len(lines) == REFUSALS_PER_S + 1
    assert lines[-1]["untold"] == 7


def test_without_a_file_nothing_is_written():
    with RequestLog(None) as log:
        log.write("start")
        log.refused("magic")
