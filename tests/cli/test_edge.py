"""The edge commands: bad input in one line; what they print of logs and how they stop."""

from pathlib import Path

import pytest

from ovibjax.errors import Doubt
from tests.cli.cases import done_here, said_of_bad_input
from tests.live.test_log_report import EDGE, ROBOTS, question, request, track, written

BAD = {
    "no such file": (("serve", "none.npz"), "none.npz: no such file"),
    "no edge file": (("serve", "other.npz"), "other.npz"),
    "a rule": (("serve", "none.npz", "--rule", "lifo"), "--rule lifo: rules are fifo, edf"),
    "a port": (("serve", "none.npz", "--port", "70000"), "--port 70000 is not 0 to 65535"),
    "a limit": (("serve", "none.npz", "--in-flight", "0"), "--in-flight 0 is not positive"),
    "a service": (("serve", "none.npz", "--service-ms", "-1"), "--service-ms -1.0 is not 0 to 60000"),
    "a speed of the paper's": (("serve", "none.npz", "--paper-speed", "-1"), "--paper-speed -1.0 is not 0 to 1000"),
    "a key": (("serve", "none.npz", "--key-file", "none.key"), "none.key: the key cannot be read"),
    "half of TLS": (("serve", "none.npz", "--tls-key", "x.pem"), "--tls-key belongs to --tls-cert"),
    "a policy": (("drive", "none.npz", "--policy", "random"), "--policy random: robots can follow voi"),
    "clients": (("drive", "none.npz", "--clients", "0"), "--clients 0 is not 1 to 65536"),
    "a speed": (("drive", "none.npz", "--speed", "0"), "--speed 0.0 is not a positive number"),
    "a budget": (("drive", "none.npz", "--budget", "nan"), "--budget nan is not a positive number"),
    "a trace": (("drive", "none.npz", "--trace", "none.txt"), "none.txt"),
    "no edge to drive with": (("drive", "none.npz"), "none.npz: no such file"),
    "not an npz": (("export", "edge.txt"), "edge.txt: the name of an edge file ends in .npz"),
    "no folder": (("export", "none/edge.npz"), "none/edge.npz: its folder does not exist"),
    "a size": (("export", "edge.npz", "--size", "huge"), "--size huge: sizes are smoke, quick, full"),
    "no log": (("report", "none.jsonl"), "none.jsonl: the log cannot be read"),
    "another file": (("report", "other.npz"), "other.npz: line 1: no event"),
    "a misspelt option": (("serve", "none.npz", "--rul", "edf"), "edge serve has no such option; did you mean --rule?"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line(case, monkeypatch, capsys, tmp_path):
    arguments, said = BAD[case]
    monkeypatch.chdir(tmp_path)
    Path("other.npz").write_text("not an archive\n")
    assert said in said_of_bad_input(monkeypatch, capsys, "edge", *arguments)


def test_an_open_port_without_a_key_is_doubted(monkeypatch, capsys, tmp_path):
    from ovibjax.cli.edge_serve import EdgeServe

    with pytest.warns(Doubt, match="anybody who reaches this port may ask"):
        EdgeServe(tmp_path / "none.npz", host="0.0.0.0")._options()
    key = tmp_path / "key"
    key.write_text("a shared key of the tests")
    assert EdgeServe(tmp_path / "none.npz", host="0.0.0.0", key_file=key)._options().key


def test_a_report_of_both_sides(monkeypatch, capsys, tmp_path):
    edge = written(tmp_path / "edge.jsonl", EDGE, request(0), request(1), {"event": "summary"})
    robots = written(tmp_path / "robots.jsonl", ROBOTS, question(0), question(1), question(2, "lost"), track(1, [1.0]))
    rows = tmp_path / "rows.csv"
    figure = tmp_path / "edge.png"
    said = done_here(
        *(monkeypatch, capsys, "edge", "report", edge, robots),
        *("--plot", "--out", figure, "--csv", rows),
    )
    assert "edf" in said
    assert "voi (killed)" in said
    assert "both sides: 3 questions, 2 answered as the edge says, 0 otherwise, 1 without an answer" in said
    assert figure.stat().st_size > 5000
    assert [line.split(",")[0] for line in rows.read_text().splitlines()] == ["side", "edge", "robots"]
