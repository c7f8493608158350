"""Units by name, and times that tell their own unit."""

import numpy as np
import pytest

from ovibjax.link.trace_columns import bps_per_unit, seconds_of, unit_in_name
from ovibjax.link.trace_files import read_trace
from tests.link.cases import refused, written


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("columns") / "trace"


UNITS = {
    "bps": 1,
    "bit/s": 1,
    "bit": 1,
    "kbps": 1e3,
    "Kbits/sec": 1e3,
    "kb/s": 1e3,
    "mbps": 1e6,
    "Mbit/s": 1e6,
    "mbit_s": 1e6,
    "Mb/s": 1e6,
    "Gbps": 1e9,
    "Bps": 8,
    "bytes_per_s": 8,
    "kB/s": 8e3,
    "kBps": 8e3,
    "MB/s": 8e6,
    "MBps": 8e6,
    "KB": 8192,
    "kb_per_s": 8192,
    "KBytes/sec": 8192,
    "MBytes/sec": 8 * 2**20,
}


@pytest.mark.parametrize("unit", UNITS)
def test_units_by_name_and_by_option(path, unit):
    assert bps_per_unit(unit) == UNITS[unit]
    trace = read_trace(written(path, "0 1\n1 0.25\n"), unit=unit)
    np.testing.assert_allclose(trace.rate_bps, np.array([1, 0.25]) * UNITS[unit])


@pytest.mark.parametrize("word", ["", "mb/s", "s", "Mbit/h", "fps", "kilo", "b", "ms"])
def test_what_is_no_unit(path, word):
    assert bps_per_unit(word) is None
    assert "--trace-unit" in refused(path, "0 1\n1 2\n", unit=word or "x")


@pytest.mark.parametrize(
    ("name", "bps"),
    [
        ("throughput_mbps", 1e6),
        ("Throughput (Mbps)", 1e6),
        ("Rate [kbit/s]", 1e3),
        ("DL MB/s", 8e6),
        ("UL_bitrate", 1e3),
        ("goodput_bytes_per_s", 8),
        ("RSRP", None),
        ("State", None),
        ("speed_kmh", None),
        ("bytes", None),
        ("fps", None),
        ("elapsed_s", None),
    ],
)
def test_units_at_the_end_of_names(name, bps):
    assert unit_in_name(name) == bps


@pytest.mark.parametrize(
    "cell",
    [
        "1575985204",
        "1575985204000",
        "1575985204000000",
        "1575985204000000000",
        "2019.12.10_13.40.04",
        "2019-12-10 13:40:04",
        "2019-12-10T13:40:04Z",
        "2019-12-10T14:40:04+01:00",
        "2019-12-10T13:40:04.000",
    ],
)
def test_times_that_tell_their_own_unit(path, cell):
    assert seconds_of(cell, 0.0) == 1575985204
    later = cell.replace("40.04", "40.06").replace("40:04", "40:06").replace("5204", "5206")
    trace = read_trace(written(path, f"Timestamp,kbps\n{cell},1\n{later},3\n"))
    assert trace.duration_s == 2 and trace.time_s[0] == 1575985204
