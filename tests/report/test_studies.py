"""Studies: means and intervals of a tidy table and of a sweep's results, as the page explores them."""

import json
import math

import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.report.claims import interval
from ovibjax.report.labels import metrics
from ovibjax.report.means import average, prepare
from ovibjax.report.web import studies
from ovibjax.report.web.studies import TableStudy, studies_of
from tests.report.cases import made_results, zipped


def rows_of(**columns):
    names = list(columns)
    return [dict(zip(names, map(str, cells), strict=True)) for cells in zip(*columns.values(), strict=True)]


SPEC = TableStudy("one", "One", ("k",), {"error_m": "error (m)"})


def test_means_and_intervals_are_those_of_claims():
    rows = rows_of(k=[8, 8, 8, 16, 16, 16], seed=[0, 1, 2, 0, 1, 2], error_m=[1.0, 2.0, 4.0, 3.0, 3.0, 3.0])
    study = SPEC.study(rows)
    assert study.axes == {"k": [8.0, 16.0]} and study.points.tolist() == [[0], [1]] and study.over == "seeds"
    expected = interval([1.0, 2.0, 4.0])
    np.testing.assert_allclose([study.mean["error_m"][0], study.half["error_m"][0]], [expected.mean, expected.half])
    assert study.half["error_m"][1] == 0 and study.count.tolist() == [3, 3]


def test_rows_that_agree_in_the_repetition_are_averaged_first():
    rows = rows_of(k=[8] * 4, room=[0, 0, 1, 1], seed=[0, 1, 0, 1], error_m=[1.0, 3.0, 5.0, 7.0])
    study = TableStudy("one", "One", ("k",), {"error_m": "error (m)"}, repetition="room").study(rows)
    expected = interval([2.0, 6.0])
    np.testing.assert_allclose([study.mean["error_m"][0], study.half["error_m"][0]], [expected.mean, expected.half])


def test_half_widths_of_the_table_are_taken_as_they_are():
    spec = TableStudy("one", "One", ("k",), {"error_m": "error (m)"}, half="_half")
    study = spec.study(rows_of(k=[8, 16], error_m=[1.0, 2.0], error_m_half=[0.25, ""]))
    assert study.mean["error_m"].tolist() == [1.0, 2.0] and study.half["error_m"][0] == 0.25
    assert math.isnan(study.half["error_m"][1]) and study.over == ""


def test_values_in_order_numbers_by_size_and_what_is_missing_last():
    rows = rows_of(k=["16", "", "8"], seed=[0, 0, 0], error_m=[1.0, 2.0, ""])
    packed = SPEC.study(rows).packed()
    (axis,) = packed["axes"]
    assert axis["values"] == [8.0, 16.0, None] and axis["texts"] == ["8", "16", "–"] and axis["numeric"]
    assert packed["points"] == [[1, 2, 0]] and packed["mean"]["error_m"] == [1.0, 2.0, None]
    assert packed["half"]["error_m"] == [None, None, None] and json.dumps(packed, allow_nan=False)


def test_names_keep_the_order_of_the_table_and_get_their_labels():
    spec = TableStudy("one", "One", ("rule",), {"error_m": "error (m)"}, labels={"rule": "Rule", "edf": "EDF"})
    (axis,) = spec.study(rows_of(rule=["fifo", "edf"], seed=[0, 0], error_m=[1, 2])).packed()["axes"]
    assert axis["label"] == "Rule" and axis["texts"] == ["fifo", "EDF"] and not axis["numeric"]


@pytest.mark.parametrize("rows", [[], rows_of(other=[1], error_m=[1]), rows_of(k=[1], seed=[0])])
def test_a_table_of_another_form_is_refused(rows):
    with pytest.raises(InputError, match="one: the table has no column"):
        SPEC.study(rows)


def test_every_row_is_a_point_where_nothing_is_repeated():
    spec = TableStudy("one", "One", ("k",), {"error_m": "error (m)"}, repetition="", optional=("recode",))
    rows = rows_of(k=[8, 8], error_m=[1.0, 2.0], recode=["False", "True"])
    study = spec.study(rows)
    assert list(study.axes) == ["k", "recode"] and study.mean["error_m"].tolist() == [1.0, 2.0] and study.over == ""
    with pytest.raises(InputError, match="several rows for one value of k"):
        spec.study(rows_of(k=[8, 8], error_m=[1.0, 2.0]))


def test_a_sweep_has_the_means_of_its_table():
    results = made_results()
    found = list(studies_of(results))
    assert sorted(name for study in found for name in study.metrics) == sorted(metrics(results))
    data, along = prepare(results, metrics(results), "seed")
    for study in found:
        for name in study.metrics:
            mean, half = (part.values for part in average(data, data[name], along))
            for point, (place, count) in enumerate(zip(study.points, study.count, strict=True)):
                np.testing.assert_allclose(study.mean[name][point], mean[tuple(place)], err_msg=name)
                np.testing.assert_allclose(study.half[name][point], half[tuple(place)], err_msg=name)
                assert count == {(2, 0): 3, (2, 3): 0}.get(tuple(place[:2]), 5)


def test_axes_that_advance_together_are_told():
    study = next(study for study in studies_of(zipped(made_results())) if "latency" in study.metrics)
    assert list(study.axes) == ["beta", "gamma"] and study.points.tolist() == [[0, 0], [1, 1], [2, 2]]
    assert study.together == [["beta", "gamma"]] and study.packed()["together"] == [["beta", "gamma"]]


def test_without_seeds_every_member_stands_by_itself():
    study = next(iter(studies_of(made_results(), over=())))
    assert "seed" in study.axes and study.over == "" and study.count.max() == 1


def test_more_than_a_page_holds_is_refused(monkeypatch):
    monkeypatch.setattr(studies, "MOST_NUMBERS", 100)
    with pytest.raises(InputError, match="means are too many for a page"):
        list(studies_of(made_results()))
