"""Corpora as they are: random Pensieve and drive-test traces with gaps, repeats and dashes; none is lost in silence."""

import datetime
import re

import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.link.trace_files import read_trace

START = datetime.datetime(2019, 12, 16, 13, 40, 4)


def pensieve(rng):
    """A two-column trace; one in six has a gap, as in the collections that people share."""
    n = rng.integers(2, 120)
    steps = rng.uniform(0.2, 2.0) * rng.uniform(0.9, 1.1, n)
    steps[rng.random(n) < rng.choice([0, 0.05])] = 0.0
    if rng.random() < 1 / 6:
        steps[rng.integers(n)] = rng.uniform(11, 4000)
    rates = rng.lognormal(0.5, 1, n) * (rng.random(n) > 0.05)
    return "".join(f"{t:.3f}{rng.choice([' ', chr(9)])}{r:.4f}\n" for t, r in zip(np.cumsum(steps), rates, strict=True))


def drive_test(rng):
    """26 columns; stamps of a second repeat or are left out, and dashes stand for what is missing."""
    n = rng.integers(3, 120)
    steps = rng.choice([0, 1, 1, 1, 1, 2], n)
    if rng.random() < 1 / 6:
        steps[rng.integers(n)] = rng.integers(11, 4000)
    names = ["Timestamp", *(f"X{i}" for i in range(11)), "DL_bitrate", "UL_bitrate", *(f"Y{i}" for i in range(12))]
    lines = [",".join(names)]
    for at in np.cumsum(steps):
        cells = [(START + datetime.timedelta(seconds=int(at))).strftime("%Y.%m.%d_%H.%M.%S")]
        values = [str(value) for value in rng.integers(0, 30_000, 25)]
        lines.append(",".join(cells + ["-" if rng.random() < 0.1 else value for value in values]))
    return "\n".join(lines) + "\n"


def read_or_settled(path, text, columns):
    """Whether a trace is read, at once or with the option that its refusal names; fails where none is named."""
    path.write_text(text)
    options = {"columns": columns}
    for _ in range(3):
        try:
            return read_trace(path, **options)
        except InputError as error:
            said = str(error)
            if "one sample has no duration" in said or "no value" in said:
                return None
            assert re.search(r"line \d+: ", said), said
            gap, column = re.search(r"--max-gap (\d+)", said), re.search(r"--trace-column (\w+)", said)
            assert gap or column, said
            options |= {"max_gap_s": float(gap[1])} if gap else {"columns": [column[1]]}
    raise AssertionError(f"{said}: not settled by what it says")


def judge(path, seed, n):
    read = 0
    for number in range(n):
        rng = np.random.default_rng((seed, number))
        text = (pensieve if number % 2 else drive_test)(rng)
        trace = read_or_settled(path, text, ())
        if trace is None:
            continue
        read += 1
        told = trace.describe()
        assert np.all(np.diff(trace.time_s) > 0) and " samples" in told and "peak" in told
        if number % 2 == 0:  # the peak is one of the file's values, or the mean of some with one stamp
            assert trace.rate_bps.max() <= 30_000e3
    return read


def test_random_corpora_are_read_or_refused_with_line_and_option(tmp_path):
    assert judge(tmp_path / "trace", 1, 400) >= 390


@pytest.mark.long
def test_ten_thousand_traces(tmp_path):
    assert judge(tmp_path / "trace", 0, 10_000) >= 9900


def test_dead_time_in_a_gap_is_what_is_said(tmp_path):
    path = tmp_path / "trace"
    path.write_text("0 2\n1 2\n2 2\n62 2\n63 2\n")
    trace = read_trace(path, max_gap_s=60)
    np.testing.assert_array_equal(trace.time_s, [0, 1, 2, 61, 62, 63])
    np.testing.assert_array_equal(trace.rate_bps, [2e6, 2e6, 2e6, 0, 2e6, 2e6])
    assert "1 gap, 60 s in all, at rate 0" in trace.describe()
