"""A sweep as a CSV or a Parquet file."""

import csv
import sys

import numpy as np
import pytest
import xarray as xr

from ovibjax.errors import Doubt, InputError
from ovibjax.report.export import exported, write_csv, write_parquet
from ovibjax.report.selection import select
from tests.report.cases import GRID, made_results, zipped


@pytest.fixture
def results() -> xr.Dataset:
    return made_results()


def test_csv_round_trip(results, tmp_path) -> None:
    write_csv(results, tmp_path / "out.csv")
    with (tmp_path / "out.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == [*GRID, "prefix", "epoch", "mean_m", "latency", "loss", "diverged"]
    # 59 finished members; two prefixes and six epochs each, apart.
    assert len(rows) == 59 * (2 + 6) and sum(row["prefix"] != "" for row in rows) == 59 * 2
    assert sum(row["diverged"] == "True" for row in rows) == 6 * 8
    for row in rows:
        at = {axis: row[axis] for axis in GRID}
        member = select(results, [f"{axis}={value}" for axis, value in at.items()]).squeeze()
        assert float(row["latency"]) == pytest.approx(float(member["latency"]), rel=1e-12)
        trailing, metric = ("prefix", "mean_m") if row["prefix"] else ("epoch", "loss")
        point = member[metric].sel({trailing: int(row[trailing])})
        assert float(row[metric]) == pytest.approx(float(point), rel=1e-6)


def test_csv_of_scalars_and_zipped_axes(results, tmp_path) -> None:
    path = tmp_path / "out.csv"
    write_csv(zipped(results)[["latency", "finished", "diverged"]], path)
    rows = list(csv.DictReader(path.read_text().splitlines()))
    assert list(rows[0]) == ["beta", "gamma", "seed", "latency", "diverged"] and len(rows) == 14
    assert {(row["beta"], row["gamma"]) for row in rows} == {("0.001", "0.01"), ("0.01", "0.1"), ("0.1", "1.0")}
    with pytest.raises(InputError, match="cannot write there"):
        write_csv(results, tmp_path / "missing" / "out.csv")


def test_parquet_holds_the_rows_and_types_of_the_csv(results, tmp_path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    data = results.assign(steps=((*GRID, "epoch"), np.arange(360).reshape(3, 4, 5, 6)))
    write_parquet(data, tmp_path / "out.parquet")
    write_csv(data, tmp_path / "out.csv")
    made = parquet.read_table(tmp_path / "out.parquet")
    with (tmp_path / "out.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert made.column_names == list(rows[0]) and len(rows) == made.num_rows
    assert {name: str(made.schema.field(name).type) for name in ("beta", "steps", "loss", "diverged")} == {
        "beta": "float",
        "steps": "int64",
        "loss": "float",
        "diverged": "bool",
    }
    for name in made.column_names:
        for found, wanted in zip(made[name].to_pylist(), (row[name] for row in rows), strict=True):
            if wanted == "":
                assert found is None or np.isnan(found)
            else:
                assert str(found) == wanted or found == pytest.approx(float(wanted), rel=1e-6)


def test_without_pyarrow_one_line_says_what_to_do(results, tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(InputError, match=r"out.parquet: Parquet files need pyarrow; pip install 'ovibjax\[parquet\]'"):
        write_parquet(results, tmp_path / "out.parquet")


def test_a_parquet_file_that_cannot_be_written(results, tmp_path) -> None:
    pytest.importorskip("pyarrow.parquet")
    with pytest.raises(InputError, match="cannot write there"):
        write_parquet(results, tmp_path / "missing" / "out.parquet")


def test_what_a_row_cannot_hold_is_named_and_a_metric_alone_is_chosen(results, tmp_path) -> None:
    path = tmp_path / "out.csv"
    data = results.assign(
        image=((*GRID, "pixel"), np.zeros((3, 4, 5, 7))), good=(tuple(GRID), np.ones((3, 4, 5), bool))
    )
    with pytest.warns(
        Doubt, match=r"out.csv: no rows for params.a.kernel, params.a.bias, bits and 2 more: not numbers"
    ):
        assert {"mean_m", "latency", "loss"} == set(exported(data, None, path).data_vars) - {"finished", "diverged"}
    write_csv(exported(data, "latency", path), path)
    assert path.read_text().splitlines()[0] == ",".join([*GRID, "latency", "diverged"])
    for name, message in (("image", "no rows for image"), ("latenzy", "did you mean latency")):
        with pytest.raises(InputError, match=message):
            exported(data, name, path)
    with pytest.raises(InputError, match="no rows for image"):
        exported(data[["image", "finished", "diverged"]], None, path)
