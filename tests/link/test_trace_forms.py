"""Every form in which traces are kept: columns, decimal marks, doubts; bytes are neither lost nor made."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.link.trace_files import read_trace
from tests.link.cases import refused, written


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("forms") / "trace"


def bits(trace):
    return float(trace.rate_bps[1:] @ np.diff(trace.time_s))


@pytest.mark.parametrize(
    ("text", "rates"),
    [
        ("time_s;mbps\n0;1,5\n1;2,25\n", [1.5, 2.25]),
        ("time_s\tmbps\n0\t1,5\n1\t2,25\n", [1.5, 2.25]),
        ("time_s\tmbps\n0\t1.5\n1\t2.25\n", [1.5, 2.25]),
        ("0;1\n1;2\n", [1, 2]),
        ("0,1\n1,2\n", [1, 2]),
        ("0,0 1,5\n1,0 2,25\n", [1.5, 2.25]),
        ("time_s mbps\n0 1\n1 2\n", [1, 2]),
        ('"time_s","mbps","note"\n0,1,"a, b"\n1,2,\n', [1, 2]),
        ("t,x\n0,1\n1,2\n", [1, 2]),
        ("0 9 1\n1 9 2\n", [1, 2]),
    ],
)
def test_separators_decimal_marks_and_chosen_columns(path, text, rates):
    chosen = {"t,x": ["mbps=x"], "0 9": ["time_s=1", "mbps=3"]}.get(text[:3], [])
    trace = read_trace(written(path, text), columns=chosen)
    np.testing.assert_allclose(trace.rate_bps / 1e6, rates)
    np.testing.assert_array_equal(trace.time_s, [0, 1])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time_s;mbps\n0;1,250\n1;2,500\n", "thousands"),
        ("time_s\tmbps\n0\t1,250.5\n1\t2\n", "'1,250.5' is not a number"),
        ("time_s\tmbps\n0\t1,250\n1\t999.5\n", "one decimal mark"),
        ('time_s,mbps\n0,"1\n1,2\n', "quote"),
    ],
)
def test_commas_in_doubt(path, text, words):
    assert words in refused(path, text)


DRIVE = """Timestamp,Longitude,NetworkMode,SNR,DL_bitrate,UL_bitrate
2021.03.01_10.15.01,8.6,LTE,7.0,100,20
2021.03.01_10.15.02,8.6,5G,-,300,-
2021.03.01_10.15.03,-,5G,7.0,500,30
2021.03.01_10.15.03,8.6,LTE,7.0,700,50
2021.03.01_10.15.04,8.6,5G,7.0,0,0
"""


def test_drive_test(path):
    assert "--trace-column DL_bitrate" in refused(path, DRIVE)
    down = read_trace(written(path, DRIVE), columns=["DL_bitrate"])
    np.testing.assert_allclose(down.rate_bps, [1e5, 3e5, 6e5, 0])
    up = read_trace(written(path, DRIVE), columns=["UL_bitrate"])
    np.testing.assert_allclose(up.rate_bps, [2e4, 4e4, 0])
    np.testing.assert_array_equal(np.diff(up.time_s), [2, 1])
    told = up.describe()
    for words in ("UL_bitrate", "1 repeated time averaged", "1 line without a value", "Longitude", "peak 40 kbit/s"):
        assert words in told


@pytest.mark.parametrize(
    ("columns", "unit", "words"),
    [
        (["XL_bitrate"], None, "no such column; there are Timestamp"),
        (["SNR"], None, "add --trace-unit"),
        (["knots=SNR"], None, "neither a time"),
        (["DL_bitrate", "time_s=Timestamp"], None, "Timestamp '2021.03.01_10.15.01' is not a number"),
        (["UL_bitrate"], "furlong", "--trace-unit furlong"),
    ],
)
def test_columns_that_cannot_be(path, columns, unit, words):
    assert words in refused(path, DRIVE, columns=columns, unit=unit)


def test_the_unit_typed_is_the_one_that_counts(path):
    trace = read_trace(written(path, DRIVE), columns=["DL_bitrate"], unit="kB")
    np.testing.assert_allclose(trace.rate_bps, np.array([1e5, 3e5, 6e5, 0]) * 8)


@settings(deadline=None, max_examples=60)
@given(st.lists(st.integers(0, 5000), min_size=1, max_size=200).map(sorted).filter(lambda stamps: stamps[-1] > 0))
def test_mahimahi_keeps_every_packet(path, stamps):
    trace = read_trace(written(path, "".join(f"{stamp}\n" for stamp in stamps)))
    np.testing.assert_allclose(bits(trace), len(stamps) * 12000, rtol=1e-9)
    np.testing.assert_allclose([trace.time_s[0], trace.time_s[-1]], [0, stamps[-1] / 1e3], atol=1e-12)
    edges = np.searchsorted(trace.time_s, stamps[-1] / 2e3)
    early = trace.rate_bps[1 : edges + 1] @ np.diff(trace.time_s[: edges + 1])
    packets = np.searchsorted(stamps, trace.time_s[edges] * 1e3 + 0.5) if edges else 0
    np.testing.assert_allclose(early, packets * 12000, rtol=1e-9)


def test_a_constant_mahimahi_link_is_one_line(path):
    trace = read_trace(written(path, "1\n"))
    assert trace.duration_s == 1e-3 and trace.rate_bps[1] == 12e6


@pytest.mark.parametrize("text", ["0.5\n1.5\n", "5\n4\n6\n", "1\n2\nx\n", "-5\n6\n"])
def test_one_column_that_is_no_packet_trace_names_the_option(path, text):
    assert "line" in (said := refused(path, text)) and ("--trace-unit" in said or "whole millisecond" in said)
    assert "line 1: 0 goes" not in said


def test_one_column_with_a_unit_is_one_rate_a_second(path):
    trace = read_trace(written(path, "5\n4\n0.5\n"), unit="Mbit")
    np.testing.assert_array_equal(trace.time_s, [0, 1, 2, 3])
    np.testing.assert_allclose(trace.rate_bps[1:], [5e6, 4e6, 5e5])


def test_bare_rates_may_change_their_unit(path):
    trace = read_trace(written(path, "2,Mbits/sec\n500,Kbits/sec\n0,bits/sec\n1,MBytes/sec\n"))
    np.testing.assert_allclose(trace.rate_bps[1:], [2e6, 5e5, 0, 8 * 2**20])
    assert trace.duration_s == 4
    assert "leave out --trace-unit" in refused(path, "2,Mbits/sec\n", unit="kbit")
    assert "line 2" in refused(path, "2,Mbits/sec\n3,parsec\n")


steps = st.lists(st.tuples(st.integers(1, 4000), st.integers(0, 10**7)), min_size=1, max_size=50)


@settings(deadline=None, max_examples=40)
@given(steps, st.sampled_from(["s", "ms"]))
def test_logs_keep_every_byte(path, steps, unit):
    clock, lines = 0, []
    for step_ms, count in steps:
        clock += step_ms
        unix = 1.4e12 + clock if unit == "ms" else 1.4e9 + clock // 1000
        lines.append(f"{unix:.0f} {clock} 51.00 -3.70 {count} {step_ms}\n")
    trace = read_trace(written(path, "".join(lines)))
    np.testing.assert_allclose(bits(trace), 8 * sum(count for _, count in steps), rtol=1e-9)
    np.testing.assert_allclose(trace.duration_s, clock / 1e3)


def iperf(rates, key="sum", **more):
    sums = [{"start": float(at), "end": float(at + 1), "bits_per_second": rate} for at, rate in enumerate(rates)]
    return {"start": {}, "intervals": [{"streams": [], key: one} | more for one in sums], "end": {}}


def test_iperf3(path):
    for text in (
        json.dumps(iperf([1e6, 0, 3e6]), indent=2),
        "\n".join(
            [json.dumps({"event": "start", "data": {}})]
            + [json.dumps({"event": "interval", "data": one}) for one in iperf([1e6, 0, 3e6])["intervals"]]
        ),
    ):
        trace = read_trace(written(path, text))
        np.testing.assert_array_equal(trace.time_s, [0, 1, 2, 3])
        np.testing.assert_array_equal(trace.rate_bps[1:], [1e6, 0, 3e6])
    both = json.dumps(iperf([1e6, 2e6], sum_bidir_reverse={"start": 0, "end": 1, "bits_per_second": 5}))
    assert "--trace-column sum" in refused(path, both)
    assert read_trace(written(path, both), columns=["sum"]).rate_bps[1] == 1e6
    warm = iperf([9e6, 1e6, 2e6])
    warm["intervals"][0]["sum"] |= {"omitted": True}
    assert bits(read_trace(written(path, json.dumps(warm)))) == 3e6


@pytest.mark.parametrize(
    "text",
    [
        "{}",
        "{",
        '{"intervals": 3}',
        '{"intervals": []}',
        '{"error": "unable to connect", "intervals": null}',
        '{"intervals": [{"sum": {"start": 1, "end": 0, "bits_per_second": 1}}]}',
        '{"intervals": [{"sum": {"start": 0, "end": 1, "bits_per_second": NaN}}]}',
        '{"intervals": [{"sum": {"start": 0, "end": 1, "bits_per_second": -1}}]}',
        '{"intervals": [{"sum": 3}]}',
        '{"intervals": [{"streams": []}]}',
        '{"a":' * 100_000,
        '{"a": 1}\n{"b"',
    ],
)
def test_json_that_is_no_iperf3(path, text):
    refused(path, text)


def test_what_went_wrong_in_iperf3_is_quoted(path):
    failed = '{"start": {}, "intervals": [], "end": {}, "error": "unable to connect to server"}'
    assert "unable to connect to server" in refused(path, failed)


@pytest.mark.parametrize(
    ("text", "option", "settled"),
    [
        ("0.0 4400\n1.0 3900\n", "--trace-unit kbit", {"unit": "kbit"}),
        ("0 941\n1 940\n", "--trace-unit kbit, or Mbit", {"unit": "Mbit"}),
        ("0.5 2150.75\n1.5 1890.5\n", "--trace-unit", {"unit": "Mbit"}),
        ("0 1\n1000 2\n2000 3\n", "--trace-column time_ms=1", {"columns": ["time_ms=1", "mbps=2"]}),
        ("0 1\n300 2\n600 3\n", "or time_s=1", {"columns": ["time_s=1", "mbps=2"]}),
    ],
)
def test_units_in_doubt_are_refused_with_the_option_that_settles_them(path, text, option, settled):
    assert option in refused(path, text)
    assert read_trace(path, **settled).time_s.size >= 2


@pytest.mark.parametrize("text", ["0 0\n1 0\n", "0 4.4\n1 310.7\n", "0 90\n1 99\n", "0 1\n1 2\n7 3\n"])
def test_usual_phones_are_in_no_doubt(path, text):
    assert read_trace(written(path, text)).time_s.size >= 2
