"""Trace files: text and CSV, every refusal with its line, hostile bytes."""

import gzip
import pickle

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ovibjax.errors import InputError
from ovibjax.link import trace_files
from ovibjax.link.trace_files import read_trace
from ovibjax.link.traces import resample
from tests.link.cases import written


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("traces") / "bus 7.log"


def test_pensieve_text(path):
    trace = read_trace(written(path, "0.0 4.03\n0.51\t4.97  \n\n   1.6 0\n"))
    np.testing.assert_array_equal(trace.time_s, [0.0, 0.51, 1.6])
    np.testing.assert_allclose(trace.rate_bps, [4.03e6, 4.97e6, 0.0], rtol=1e-15)
    assert trace.time_s.dtype == trace.rate_bps.dtype == np.float64
    assert trace.duration_s == 1.6 and trace.source == str(path)


# The table of the module's documentation, written out once more.
@pytest.mark.parametrize(
    ("time", "rate", "seconds", "bps"),
    [
        ("time_s", "mbit_s", 1.0, 1e6),
        ("time_ms", "mbps", 1e-3, 1e6),
        ("timestamp", "kbps", 1.0, 1e3),
        ("time_s", "bps", 1.0, 1.0),
        ("time_ms", "kb_per_s", 1e-3, 8192.0),
        ("timestamp", "bytes_per_s", 1.0, 8.0),
    ],
)
@pytest.mark.parametrize("swap", [False, True])
def test_csv_units(path, time, rate, seconds, bps, swap):
    rows = [(time, rate), ("100", "0"), ("350", "12.5"), ("400", "3e1")]
    text = "\n".join(",".join(row[::-1] if swap else row) for row in rows)
    trace = read_trace(written(path, text), max_gap_s=1e6)
    np.testing.assert_allclose(trace.time_s, np.array([100, 350, 400]) * seconds, rtol=1e-15)
    np.testing.assert_allclose(trace.rate_bps, np.array([0, 12.5, 30]) * bps, rtol=1e-15)


def test_what_files_from_the_field_look_like(path):
    text = '\ufeff# modem 3, "north" route, 0,1\r\n\r\n"time_s" , "kbps"\r\n0 ,  1 # start\r\n#\r\n1e0,+2.\r\n.2e1,3'
    trace = read_trace(written(path, text))
    np.testing.assert_array_equal(trace.time_s, [0, 1, 2])
    np.testing.assert_array_equal(trace.rate_bps, [1e3, 2e3, 3e3])
    old_mac = read_trace(written(path, "-1 1\r0 2\r1 3\r"))
    np.testing.assert_array_equal(old_mac.time_s, [-1, 0, 1])
    unix = read_trace(written(path, "timestamp,bps\n1700000000.25,1\n1700000000.75,2\n"))
    assert unix.duration_s == 0.5


times = st.lists(st.integers(1, 9_999_999), min_size=2, max_size=40).map(lambda steps: np.cumsum(steps) / 1e6)


@settings(deadline=None, max_examples=60)
@given(times, st.data(), st.sampled_from(["text", "csv"]))
def test_round_trip(path, time_s, data, kind):
    rates = data.draw(st.lists(st.floats(0, 1e9), min_size=len(time_s), max_size=len(time_s)))
    header, separator, unit = ("", " ", 1e6) if kind == "text" else ("time_s,bps\n", ",", 1.0)
    lines = (f"{float(t)!r}{separator}{rate!r}\n" for t, rate in zip(time_s, rates, strict=True))
    trace = read_trace(written(path, header + "".join(lines)), unit="Mbit" if kind == "text" else None)
    np.testing.assert_array_equal(trace.time_s, time_s)
    np.testing.assert_array_equal(trace.rate_bps, np.array(rates) * unit)


GOOD = "# measured\n0 1\n1 2\n\n2 3\n"  # samples on lines 2, 3 and 5

CSV = "time_s,kbps\n0,1\n1,2\n"

BAD_FILES = [
    ("", None, "no samples"),
    ("\n# nothing\n  \n", None, "no samples"),
    ("\ufeff", None, "no samples"),
    ("\n0 1\n", 2, "one sample has no duration"),
    ("# a\ntime_s,kbps\n", None, "no sample follows the first line"),
    ("time_s,kbps\n0,1\n", 2, "one sample"),
    (GOOD + "\n1.5 4\n", 7, "1.5 s goes back from 2.0 s of line 5"),
    ("time_ms,bps\n5,1\n5.0,1\n", 2, "one sample has no duration"),
    (GOOD + "3 -0.1\n", 6, "mbit_s '-0.1' is negative"),
    (CSV + "2,-1e-9\n", 4, "kbps '-1e-9' is negative"),
    *[(GOOD + f"3 {token}\n", 6, f"mbit_s '{token}' is not finite") for token in ("-inf", "Infinity", "1e999")],
    (CSV + "inf,3\n", 4, "time_s 'inf' is not finite"),
    ("time_s,kbps\n0,-\n,1\n", None, "2 lines have no value"),
    *[
        (GOOD + f"3 {token}\n", 6, f"mbit_s '{token}' is not a number")
        for token in ("x", "0x10", "1_0", "1,5", "٣", "--1")
    ],
    (CSV + "2023-01-01 10:00:00,3\n", 4, "time_s '2023-01-01 10:00:00' is not a number"),
    (GOOD + "mbps 1\n", 6, "time 'mbps' is not a number; comment out"),
    (GOOD + "3\n", 6, r"1 column, expected 2 \(time, mbit_s\)"),
    (GOOD + "3 4 5\n", 6, "3 columns, expected 2"),
    (CSV + "2\n", 4, r"1 column, expected 2 \(time_s, kbps\)"),
    (CSV + "2,3,\n", 4, "3 columns, expected 2"),
    ("when,mbps\n0,1\n", 1, "no column of times among when, mbps; name it: --trace-column time_s=when"),
    ("time_s,speed\n0,1\n", 1, "no column of rates .* --trace-column kbps=speed"),
    ("time_s,\n0,1\n", 1, "no column of rates"),
    ("time_s,time_ms,mbps\n0,1,2\n", 1, r"several times \(time_s, time_ms\); name it: --trace-column time_s"),
    ("mbps,kbps\n0,1\n", 1, "no column of times among mbps, kbps; .*--trace-column time_s=NAME"),
    ("time_s,mbps,kbps\n0,1,2\n", 1, r"several rates \(mbps, kbps\); choose one: --trace-column mbps"),
    ("time_s,mbps,mbps\n0,1,2\n", 1, "several rates"),
    ("0 1 2\n1 1 2\n", 1, "3 columns without names; .*--trace-column time_s=1 mbps=3"),
    (
        "time_s,bps\n1700000000000,1\n",
        2,
        "no time in its unit; milliseconds are read with --trace-column time_ms=time_s",
    ),
    ("0 1\n1 1e10\n", 2, r"'1e10' is over 1e\+15 bit/s; check --trace-unit"),
    (b"0 1\n1 2\r2 \xff3\r\n3 4", 3, "not UTF-8"),
    (b"\xef\xbb\xbf0 1\r\n\xe9 2\n", 2, "not UTF-8"),
    (b"0 1\n1 2\n\0\0\n", 3, "binary"),
    ("0 1\n1 2\n".encode("utf-16"), 1, "binary file or UTF-16"),
    (gzip.compress(GOOD.encode() * 9, mtime=0), None, "bus 7.log: line"),
    (pickle.dumps([[0.0, 1.0]] * 5), None, "bus 7.log: line"),
    (GOOD + "3 " + "9" * 5000, 6, "5002 characters, over 4000"),
    ("," * 5000, 1, "5000 characters, over 4000"),
    ("0 1\n1 2\n2 2\n12.5 3\n", 4, "gap of 10.5 s after line 3, over 10 s; --max-gap 11 "),
    ("0 1\n4 1\n8 1\n# lost\n29 1\n33 1\n", 5, "gap of 21 s after line 3, over 20 s"),
]


@pytest.mark.parametrize(("content", "line", "reason"), BAD_FILES)
def test_refusals_name_file_line_and_reason(path, content, line, reason):
    place = "bus 7.log: " + ("" if line is None else f"line {line}: ")
    with pytest.raises(InputError, match=reason) as caught:
        read_trace(written(path, content))
    message = str(caught.value)
    assert place in message and message.isprintable() and len(message) < 450


def test_gaps(path):
    ten = written(path, "0 1\n1 2\n2 2\n12 3\n")
    assert read_trace(ten).duration_s == 12  # 10 s is the longest that never is a gap
    slow = written(path, "0 1\n4 1\n8 1\n28 1\n32 1\n")
    assert read_trace(slow).duration_s == 32  # 5 median intervals
    with pytest.raises(InputError, match=r"line 4: gap of 20 s after line 3, over 19\.5 s"):
        read_trace(slow, max_gap_s=19.5)
    outage = written(path, "0 1\n1 1\n5000 1\n")
    assert read_trace(outage, max_gap_s=np.inf).duration_s == 5000
    for bad in (0.0, -1.0, np.nan):
        with pytest.raises(InputError, match=r"--max-gap .* is not a positive"):
            read_trace(outage, max_gap_s=bad)


def test_what_is_not_a_file(tmp_path):
    for name, reason in [("missing", "no such file"), (".", "not a regular file"), ("a\0b", "no such file")]:
        with pytest.raises(InputError, match=reason):
            read_trace(tmp_path / name)
    split_name = written(tmp_path / "two\nlines", "x")
    with pytest.raises(InputError) as caught:
        read_trace(split_name)
    assert str(caught.value).isprintable()


def test_a_huge_file_is_refused_by_its_size_alone(tmp_path, monkeypatch):
    huge = tmp_path / "huge.log"
    with huge.open("wb") as file:
        file.truncate(trace_files.MAX_TRACE_BYTES + 1)  # sparse: it takes no room
    monkeypatch.setattr("pathlib.Path.open", lambda *_: pytest.fail("the file was opened"))
    with pytest.raises(InputError, match=r"huge.log: too large: 52428801 bytes, over 52428800"):
        read_trace(huge)


def test_an_unreadable_file_is_bad_input(tmp_path, monkeypatch):
    file = written(tmp_path / "locked.log", GOOD)

    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pathlib.Path.open", refuse)
    with pytest.raises(InputError, match=r"locked.log: cannot be read \(Permission denied\)"):
        read_trace(file)


def reads_or_refuses(path, content):
    """Either a sane trace that resamples, or one line of refusal; any other exception fails the test."""
    try:
        trace = read_trace(written(path, content))
    except InputError as error:
        assert str(error).isprintable() and str(error).startswith(str(path))
        return False
    assert trace.time_s.size >= 2 and np.all(np.diff(trace.time_s) > 0)
    assert np.all(np.isfinite(trace.rate_bps)) and np.all(trace.rate_bps >= 0)
    rates = resample(trace, trace.duration_s, 3)
    assert np.all(np.isfinite(rates)) and np.all(rates >= 0)
    return True


@settings(deadline=None, max_examples=200)
@given(st.binary(max_size=200))
def test_random_bytes(path, content):
    reads_or_refuses(path, content)


tokens = st.sampled_from(
    ["0", "1", "2.5", "-3", "1e9", "1e-300", "nan", "inf", "x", "٣", "time_s", "mbps", '"', "#", ""]
)

breaks = st.sampled_from([" ", ",", "\n", "\r\n", "\r", "\t", "\x0b", "\u2028", ", ", "\n\n"])


@settings(deadline=None, max_examples=300)
@given(
    st.lists(st.tuples(tokens, breaks), max_size=30), st.sampled_from(["", "time_s,mbps\n", "\ufeff", "kbps,time_ms\n"])
)
@example([("0", " "), ("1", "\n"), ("1e-300", " "), ("1", "\n")], "")
@example([("0", " "), ("1", "\n"), ("1e9", " "), ("1", "\n")], "")
def test_random_tables(path, pairs, header):
    reads_or_refuses(path, header + "".join(token + separator for token, separator in pairs))


@settings(deadline=None, max_examples=100)
@given(st.binary(max_size=6), st.integers(0, 40), st.integers(0, 6))
def test_good_files_with_some_bytes_replaced(path, patch, at, cut):
    content = b"time_s,kbps\n0,10\n1.5,20\n2,30\n10,0\n"
    reads_or_refuses(path, content[:at] + patch + content[at + cut :])
