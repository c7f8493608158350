"""Numbers as instruments write them are read; what only Python reads is none."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ovibjax.cli.options import integers, numbers
from ovibjax.errors import InputError
from ovibjax.features.images.by_path import open_source
from ovibjax.runtime.plain_numbers import plain_float, plain_int
from tests.features.images.made_images import write_table


@given(st.floats(), st.sampled_from(["{!r}", "{:e}", "{:+.17g}", " {!r} "]))
def test_floats_are_read_as_python_writes_them(value, form):
    again = plain_float(form.format(value))
    assert math.isnan(value) if math.isnan(again) else again == pytest.approx(value, rel=1e-6)


@given(st.integers())
def test_whole_numbers_are_read(value):
    assert plain_int(str(value)) == plain_int(f"{value:+d}") == value


@given(st.integers(1000, 10**9))
def test_digits_apart_are_no_number(value):
    for text in (f"{value:_d}", f"{value:_d}.5", f"1e{value:_d}"):
        with pytest.raises(ValueError, match="plain notation"):
            plain_float(text)
        with pytest.raises(ValueError):
            plain_int(text)


@pytest.mark.parametrize("text", ["١٢", "１２", "1\u00a0000", "1'000", "1,000", "", "-", "0x10", "12 m"])
def test_what_is_no_number(text):
    for read in (plain_float, plain_int):
        with pytest.raises(ValueError):
            read(text)


@pytest.mark.parametrize("cell", ["1_000", "１２", "1'000"])
@pytest.mark.parametrize("column", ["x_m", "y_m", "z_m", "yaw_deg"])
def test_a_table_names_line_and_value(tmp_path, column, cell):
    table = write_table(tmp_path, 3)
    header, *rows = table.read_text(encoding="utf-8").splitlines()
    cells = rows[1].split(",")
    cells[header.split(",").index(column)] = cell
    table.write_text("\n".join([header, rows[0], ",".join(cells), rows[2]]), encoding="utf-8")
    with pytest.raises(InputError, match=f"line 3.*{column}.*{cell}"):
        open_source(table, "images/{view}/{frame}.png")


@pytest.mark.parametrize(("typed", "hint"), [("1e-4,1e-3", "--beta 1e-4 1e-3"), ("1, 2,3", "--beta 1 2 3")])
def test_commas_between_values_are_told_of_spaces(typed, hint):
    with pytest.raises(InputError, match=f"write several with spaces: {hint}$"):
        numbers("beta", (typed,), lambda value: True, "any")
    with pytest.raises(InputError, match="write several with spaces: --seed 0:2 5"):
        integers("seed", ("0:2,5",), 0, 9)
    with pytest.raises(InputError, match=r"not a number; values are any$"):
        numbers("beta", ("1_000",), lambda value: True, "any")
