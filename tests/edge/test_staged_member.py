"""The encoder in stages: halved, the members that go on have the bits of a training in one go."""

from dataclasses import replace

import numpy as np
import pytest

from ovibjax.edge.member import DIMS, SCORE, TrainAndJudge
from ovibjax.sweep.engine import run
from ovibjax.sweep.halving import halve
from ovibjax.sweep.work import Along
from tests.edge.cases import KS, STATIC, two_members
from tests.sweep.staged_members import differences, last_of

AXES = {"beta": [1e-4, 1e-3, 1e-1, 10.0], "lr": [1e-3, 4e-3], "seed": [0, 1]}


@pytest.mark.parametrize("lanes", [None, pytest.param(3, marks=pytest.mark.slow)])
def test_an_encoder_that_goes_on_has_the_bits_of_a_whole_training(lanes, tmp_path):
    members = two_members()
    static = replace(STATIC, steps=45)
    at_once = TrainAndJudge(static, KS, ("A5",), keep_params=True)
    fn, data = at_once.staged(len(members[0].train.x)), Along("seed", members)
    assert fn.steps == static.steps_on(len(members[0].train.x)) == 9 * fn.every
    found = halve(fn, AXES, data, score=SCORE, lanes=lanes, dims=DIMS, store=tmp_path / "a.zarr")
    assert [rung["points"] for rung in found.attrs["rungs"]] == [8, 2, 1] and found.attrs["spent"] < 0.4
    whole = run(fn, AXES, data, lanes=lanes, dims=DIMS)
    assert any(str(name).startswith("params.") for name in whole)
    assert not differences(found, whole, ("beta", "lr"), fn.steps)
    assert found.attrs["config"]["function"] == whole.attrs["config"]["function"] == "ovibjax.edge.member.TrainAndJudge"
    if lanes is not None:
        plain, end = run(at_once, AXES, data, dims=DIMS), last_of(found, fn.steps)
        at = {name: end[name].values[0] for name in ("beta", "lr")}
        for name in whole.data_vars:
            np.testing.assert_allclose(
                end[name].isel({end.steps.dims[0]: 0}), plain[name].sel(at), rtol=2e-3, atol=1e-4
            )
