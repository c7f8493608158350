"""Text tables: lines keep their numbers, cells come back from every dialect, commas are read as what they are."""

import csv
import io

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.errors import InputError
from ovibjax.runtime.text_tables import (
    ContentLines,
    cells_of,
    is_missing,
    number_of,
    quoted,
    read_text,
    separator_of,
    with_points,
)


def rows_of(text, separator=",", **options):
    lines = ContentLines(text)
    return [(lines.number, cells) for cells in cells_of("t.csv", lines, separator, **options)]


cells = st.text(st.characters(codec="utf-8", exclude_characters="\r\n\x00", exclude_categories=["Cs"]), max_size=8)
tables = st.lists(st.lists(cells, min_size=2, max_size=4), min_size=1, max_size=6)


@settings(deadline=None, max_examples=150)
@given(tables, st.sampled_from([",", ";", "\t"]), st.sampled_from(["\n", "\r\n"]), st.booleans())
def test_what_csv_writes_comes_back(table, separator, end, strict):
    stream = io.StringIO()
    csv.writer(stream, delimiter=separator, lineterminator=end, quoting=csv.QUOTE_ALL).writerows(table)
    expected = [(line, [cell.strip() for cell in row]) for line, row in enumerate(table, start=1)]
    assert rows_of(stream.getvalue(), separator, strict=strict) == expected


@settings(deadline=None)
@given(st.lists(st.sampled_from(["", "  ", "# note", " # note", "a", "b # c"])), st.sampled_from(["\n", "\r\n", "\r"]))
def test_lines_keep_their_numbers(lines, end):
    found = ContentLines(end.join(lines))
    kept = [(number, line) for number, line in enumerate(lines, start=1) if line.strip() and "# note" not in line]
    assert [(found.number, line) for line in found] == kept
    inline = ContentLines(end.join(lines), inline_comments=True)
    assert [(inline.number, line.strip()) for line in inline] == [(n, line.split(" #")[0]) for n, line in kept]


@pytest.mark.parametrize(
    ("line", "separator"),
    [
        ("a,b", ","),
        ("a;b,c", ";"),
        ("a\tb c", "\t"),
        ("a b", " "),
        ("1 2", " "),
        ("1\t2", " "),
        ("1,5 2,5", " "),
        ("1,5\t2,5", " "),
        ("0, 1.5", ","),
        ("1;2", ";"),
        ("one", " "),
    ],
)
def test_separators(line, separator):
    assert separator_of(line) == separator


@pytest.mark.parametrize("text", ['a,"b\nc,d\n', '"a,b\n', 'a,b\n"x\ny",c\n'])
def test_a_quote_over_several_lines_is_refused(text):
    with pytest.raises(InputError, match=r"t.csv: line \d+: "):
        rows_of(text + "e,f\n" * 3)


def test_text_behind_a_quote():
    assert rows_of('"a"b,c\n') == [(1, ["ab", "c"])]
    with pytest.raises(InputError, match="line 1"):
        rows_of('"a"b,c\n', strict=True)


numbers = st.floats(-1e6, 1e6).map(lambda value: f"{value:.4f}")


@settings(deadline=None)
@given(st.lists(numbers, min_size=1, max_size=8))
def test_decimal_commas_become_points(values):
    rows = ((line, ["a,5", value.replace(".", ",")]) for line, value in enumerate(values))
    assert [row for _, row in with_points("t", rows, {1})] == [["a,5", value] for value in values]


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ([["1,5"], ["2.5"]], "line 1: '1,5' here and '2.5' in line 2"),
        ([["2.5"], ["1,5"]], "line 2: '1,5' here and '2.5' in line 1"),
        ([["1,500"], ["12,250"]], "line 1: '1,500' may be thousands"),
    ],
)
def test_commas_in_doubt_are_refused(rows, words):
    with pytest.raises(InputError, match=words):
        list(with_points("t", iter(enumerate(rows, start=1))))


@pytest.mark.parametrize("settles", ["0,250", "1,5", "1234,250"])
def test_one_number_settles_what_commas_are(settles):
    (_, first), _ = with_points("t", iter([(1, ["1,500"]), (2, [settles])]))
    assert first == ["1.500"]


@pytest.mark.parametrize("cell", ["", "-", "NA", "n/a", "NaN", "null", "None", "#N/A", "--"])
def test_what_is_missing(cell):
    assert is_missing(cell)


@pytest.mark.parametrize("cell", ["0", "-1", "inf", "no", "a-", "."])
def test_what_is_not(cell):
    assert not is_missing(cell)


@pytest.mark.parametrize("cell", ["1_000", "٣", "0x10", "1,5", "", "1 2", "--5", "1.000,5"])
def test_what_is_no_number(cell):
    assert number_of(cell) is None


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"a\0", "binary"),
        (b"a\nb\xff", "line 2: not UTF-8"),
        ("a,b".encode("utf-16"), "UTF-16"),
        (b"x" * 101, "too large: 101 bytes, over 100"),
    ],
)
def test_files_that_are_no_text(tmp_path, content, words):
    path = tmp_path / "t.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match=words):
        read_text(path, 100, "table")


def test_a_byte_order_mark_is_dropped(tmp_path):
    (tmp_path / "t").write_bytes(b"\xef\xbb\xbfa\r\nb")
    assert read_text(tmp_path / "t", 100, "table") == "a\r\nb"
    for name, words in (("absent", "no such file"), (".", "not a regular file; name one table")):
        with pytest.raises(InputError, match=words):
            read_text(tmp_path / name, 100, "table")


def test_long_cells_are_cut_in_messages():
    assert quoted("a") == "'a'" and len(quoted("a" * 99)) == 42
