"""Trace files: both formats, every refusal with its line, hostile bytes, and resampling against exact sums."""

import gzip
import pickle

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ovibjax.errors import InputError
from ovibjax.link import traces
from ovibjax.link.traces import Trace, read_trace, resample
from tests.oracles import channel as oracle


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("traces") / "bus 7.log"


def written(path, content):
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


# --- formats -------------------------------------------------------------------------------------------------------


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
    trace = read_trace(written(path, header + "".join(lines)))
    np.testing.assert_array_equal(trace.time_s, time_s)
    np.testing.assert_array_equal(trace.rate_bps, np.array(rates) * unit)


def test_a_trace_is_a_read_only_copy():
    time_s = np.array([0.0, 1.0])
    trace = Trace(time_s, [1, 2])
    time_s[0] = 9
    assert trace.time_s[0] == 0 and trace.rate_bps.dtype == np.float64
    with pytest.raises(ValueError, match="read-only"):
        trace.rate_bps[0] = 1


# --- refusals ------------------------------------------------------------------------------------------------------

GOOD = "# measured\n0 1\n1 2\n\n2 3\n"  # samples on lines 2, 3 and 5
CSV = "time_s,kbps\n0,1\n1,2\n"
BAD_FILES = [
    ("", None, "no samples"),
    ("\n# nothing\n  \n", None, "no samples"),
    ("\ufeff", None, "no samples"),
    ("\n0 1\n", 2, "one sample has no duration"),
    ("# a\ntime_s,kbps\n", 2, "no sample follows the header"),
    ("time_s,kbps\n0,1\n", 2, "one sample"),
    (GOOD + "2 4\n", 6, "2.0 s repeats 2.0 s of line 5"),
    (GOOD + "\n1.5 4\n", 7, "1.5 s goes back from 2.0 s of line 5"),
    ("time_ms,bps\n5,1\n5.0,1\n", 3, "repeats"),
    (GOOD + "3 -0.1\n", 6, "mbit_s '-0.1' is negative"),
    (CSV + "2,-1e-9\n", 4, "kbps '-1e-9' is negative"),
    *[(GOOD + f"3 {token}\n", 6, f"mbit_s '{token}' is not finite") for token in ("nan", "-inf", "Infinity", "1e999")],
    (CSV + "nan,3\n", 4, "time_s 'nan' is not finite"),
    *[
        (GOOD + f"3 {token}\n", 6, f"mbit_s '{token}' is not a number")
        for token in ("x", "0x10", "1_0", "1,5", "٣", "--1")
    ],
    (CSV + ",3\n", 4, "time_s '' is not a number"),
    (CSV + "2023-01-01 10:00:00,3\n", 4, "time_s '2023-01-01 10:00:00' is not a number"),
    ("time_s mbps\n0 1\n", 1, "time_s 'time_s' is not a number; comment out"),
    (GOOD + "3\n", 6, r"1 column, expected 2 \(time_s, mbit_s\)"),
    (GOOD + "3 4 5\n", 6, "3 columns, expected 2"),
    ("0;1\n1;2\n", 1, "1 column, expected 2"),
    (CSV + "2\n", 4, r"1 column, expected 2 \(time_s, kbps\)"),
    (CSV + "2,3,\n", 4, "3 columns, expected 2"),
    ("time_s,Mbps\n0,1\n", 1, "unknown column 'Mbps'; .*mbps"),
    ("\nt,mbps\n0,1\n", 2, "unknown column 't'; .*time_ms"),
    ("0,1\n1,2\n", 1, "unknown column '0'; the first line names"),
    ("time_s,mbps,lat\n0,1,2\n", 1, "unknown column 'lat'"),
    ("time_s,\n0,1\n", 1, "unknown column ''"),
    ("time_s,time_ms\n0,1\n", 1, "columns 'time_s, time_ms'; a trace has two"),
    ("mbps,kbps\n0,1\n", 1, "a trace has two"),
    ("time_s,mbps,kbps\n0,1,2\n", 1, "a trace has two"),
    ("timestamp,bps\n1700000000000,1\n", 2, "'1700000000000' is no time in its unit; milliseconds go in time_ms"),
    ("0 1\n1 1e10\n", 2, r"'1e10' is over 1e\+15 bit/s; check the unit"),
    (b"0 1\n1 2\r2 \xff3\r\n3 4", 3, "not UTF-8"),
    (b"\xef\xbb\xbf0 1\r\n\xe9 2\n", 2, "not UTF-8"),
    (b"0 1\n1 2\n\0\0\n", 3, "binary"),
    ("0 1\n1 2\n".encode("utf-16"), 1, "binary file or UTF-16"),
    (gzip.compress(GOOD.encode() * 9, mtime=0), None, "bus 7.log: line"),
    (pickle.dumps([[0.0, 1.0]] * 5), None, "bus 7.log: line"),
    (GOOD + "3 " + "9" * 2000, 6, "2002 characters, over 1000"),
    ("," * 5000, 1, "5000 characters, over 1000"),
    ("0 1\n1 2\n2 2\n12.5 3\n", 4, "gap of 10.5 s after line 3, over 10 s; .*max_gap_s"),
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
        with pytest.raises(InputError, match="max_gap_s must be positive"):
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
        file.truncate(traces.MAX_TRACE_BYTES + 1)  # sparse: it takes no room
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


@pytest.mark.parametrize(
    ("time_s", "rate", "reason"),
    [
        ([0.0], [1.0], "two or more"),
        ([0.0, 1.0], [1.0], "one rate per time"),
        ([[0.0, 1.0]], [[1.0, 2.0]], "shape"),
        ([0.0, 0.0], [1.0, 1.0], "increase"),
        ([0.0, np.nan], [1.0, 1.0], "increase"),
        ([0.0, np.inf], [1.0, 1.0], "finite"),
        ([0.0, 1.0], [1.0, -1.0], "rates must be"),
        ([0.0, 1.0], [np.nan, 1.0], "rates must be"),
    ],
)
def test_traces_made_by_hand_are_checked(time_s, rate, reason):
    with pytest.raises(InputError, match=f"mine: .*{reason}"):
        Trace(time_s, rate, "mine")


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


# --- resampling ----------------------------------------------------------------------------------------------------


def test_a_rate_holds_over_the_interval_it_ends():
    # As in Pensieve's simulator, which walks the samples from the second one and wraps to time 0.
    trace = Trace([0, 1, 3], [9, 2, 4])
    out = resample(trace, 1.0, 7)
    np.testing.assert_array_equal(out, [2, 4, 4, 2, 4, 4, 2])
    assert out.dtype == np.float32
    np.testing.assert_allclose(resample(trace, 1.5, 2), [(2 + 0.5 * 4) / 1.5, 4], rtol=1e-6)
    np.testing.assert_allclose(resample(trace, 30.0, 1, start_s=0.7), [10 / 3], rtol=1e-6)  # ten rounds
    shifted = Trace(np.array([0, 1, 3]) + 1.7e9, [9, 2, 4])
    np.testing.assert_array_equal(resample(shifted, 1.0, 7), out)


@settings(deadline=None, max_examples=150)
@given(
    st.lists(st.tuples(st.integers(1, 12), st.integers(0, 1000) | st.just(0)), min_size=1, max_size=12),
    st.integers(1, 40),
    st.integers(1, 12),
    st.integers(0, 100),
    st.sampled_from([1 / 8, 0.1, 1e-3, 7.0]),
    st.sampled_from([0.0, 123.456]),
)
def test_resampling_equals_a_fine_grid(pieces, slot_ticks, n_slots, start_ticks, tick_s, origin_s):
    ticks = [0, *np.cumsum([length for length, _ in pieces]).tolist()]
    rates = [777, *(rate for _, rate in pieces)]
    trace = Trace(origin_s + tick_s * np.array(ticks), rates)
    expected = oracle.resample(ticks, rates, slot_ticks, n_slots, start_ticks)
    out = resample(trace, tick_s * slot_ticks, n_slots, tick_s * start_ticks)
    assert out.shape == (n_slots,) and out.dtype == np.float32
    np.testing.assert_allclose(out, expected, rtol=1e-5)
    # A dead slot is exactly dead even where 0.1 s has no exact binary form: its delay is infinite, not years.
    np.testing.assert_array_equal(out == 0, np.array(expected) == 0)
    if (start_ticks + n_slots * slot_ticks) <= ticks[-1]:
        np.testing.assert_array_equal(
            resample(trace, tick_s * slot_ticks, n_slots, tick_s * start_ticks, loop=False), out
        )


@settings(deadline=None, max_examples=100)
@given(st.integers(0, 2**31), st.floats(0.01, 50), st.floats(0, 500))
def test_resampling_conserves_bits_and_stays_in_range(seed, slot_s, start_s):
    rng = np.random.default_rng(seed)
    trace = Trace(np.cumsum(rng.exponential(size=30)), rng.exponential(size=30) * 1e6)
    out = resample(trace, slot_s, 25, start_s).astype(np.float64)
    assert np.all(out <= trace.rate_bps[1:].max() * (1 + 1e-6)) and np.all(out >= trace.rate_bps[1:].min() * (1 - 1e-6))
    whole = resample(trace, 25 * slot_s, 1, start_s)
    np.testing.assert_allclose(out.mean(), whole[0], rtol=2e-5)
    np.testing.assert_allclose(resample(trace, slot_s, 25, start_s + trace.duration_s), out, rtol=2e-4)


def test_a_constant_trace_stays_constant():
    trace = Trace(np.cumsum(np.random.default_rng(3).uniform(0.1, 2, 500)), np.full(500, 65536.0))
    np.testing.assert_allclose(resample(trace, 0.5, 2000), 65536.0, rtol=2e-7)


def test_short_traces_without_looping(path):
    trace = read_trace(written(path, GOOD))
    np.testing.assert_array_equal(resample(trace, 0.5, 4, loop=False), [2e6, 2e6, 3e6, 3e6])
    message = r"bus 7.log: too short: it lasts 2 s, but 4 slots of 0.5 s from 0.25 s end at 2.25 s; .* let it loop"
    with pytest.raises(InputError, match=message):
        resample(trace, 0.5, 4, start_s=0.25, loop=False)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ((0.0, 3), "slot_s 0.0"),
        ((-1.0, 3), "slot_s -1.0"),
        ((np.nan, 3), "slot_s nan"),
        ((np.inf, 3), "slot_s inf"),
        ((1e300, 3), "positive finite"),
        ((1.0, 0), "n_slots 0"),
        ((1.0, 3, -0.5), "start_s -0.5"),
        ((1.0, 3, np.nan), "start_s nan"),
        ((1e-9, 3, 1e9), "too short to tell slots apart"),
    ],
)
def test_resample_refuses(arguments, reason):
    with pytest.raises(InputError, match=reason):
        resample(Trace([0, 1], [1, 1]), *arguments)


def test_an_instant_is_not_repeated_forever():
    with pytest.raises(InputError, match="burst: too short: it lasts 1e-09 s, but 9 slots of 1 s"):
        resample(Trace([0, 1e-9], [1, 1], "burst"), 1.0, 9)
