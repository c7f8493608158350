"""What the doctor says of an installation."""

from importlib.metadata import requires

import pytest

import ovibjax
from ovibjax.cli import doctor
from ovibjax.edge import self_test
from tests.cli.cases import done_here


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("OVIBJAX_CACHE", str(tmp_path / "cache"))
    (tmp_path / "cache" / "town").mkdir(parents=True)
    (tmp_path / "cache" / "town" / "a.npz").write_bytes(bytes(3_000_000))


def test_everything_that_a_report_of_a_fault_should_hold(monkeypatch, capsys, tmp_path):
    said = done_here(monkeypatch, capsys, "doctor")
    lines = {line.split()[0]: line for line in said.splitlines()}
    assert list(lines) == [
        *("ovibjax", "versions", "system", "processor", "devices", "precision", "cache", "extras", "self-test")
    ]
    assert "Python 3." in lines["versions"] and "missing" not in lines["versions"]
    assert "cpu:0" in lines["devices"] and lines["precision"].split()[1] in ("float32,", "bfloat16,")
    assert f"{tmp_path / 'cache'}, 3 MB (OVIBJAX_CACHE says where)" in lines["cache"]
    assert "[video] " in lines["extras"] and "[dev]" not in lines["extras"]
    assert "passed: 3.4" in lines["self-test"] and "s without" in lines["self-test"]


def test_a_wrong_number_is_told_and_ends_with_1(monkeypatch, capsys):
    monkeypatch.setattr(self_test, "EXPECTED_M", (3.464, 2.9))
    with pytest.raises(SystemExit) as ended:
        doctor.Doctor().run()
    assert ended.value.code == 1
    assert "FAILED: 3.4" in capsys.readouterr().out


def test_no_cache_yet_and_an_extra_that_is_not_there(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(doctor, "installed", lambda name: None if name == "av" else "1")
    assert doctor.optional_parts()["video"] == ["av"] and doctor.optional_parts()["parquet"] == []
    assert set(doctor.optional_parts()) < {line.rpartition("== ")[2].strip("'\"") for line in requires("ovibjax")}
    assert ", 0 MB (" in doctor.cache_line(tmp_path / "none")
    assert "self-test" not in done_here(monkeypatch, capsys, "doctor", "--no-self-test")


@pytest.mark.parametrize("recorded", ["0.0.1", None])
def test_the_version_is_that_of_the_code_that_runs(monkeypatch, recorded):
    monkeypatch.setattr(doctor, "installed", lambda name: recorded)
    said = dict(doctor.Doctor()._facts())["ovibjax"]
    assert said.startswith(f"{ovibjax.__version__} in ") and f"installed as {recorded or 'nothing'}" in said
