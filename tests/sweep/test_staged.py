"""Cut anywhere, a member has the bits of one that was trained in one go."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.sweep.engine import run
from ovibjax.sweep.halving import halve
from ovibjax.sweep.staged import Staged, form_of
from ovibjax.sweep.store import open_dataset
from ovibjax.sweep.work import Along
from tests.sweep.members import finish, start
from tests.sweep.staged_members import AXES, DATA, FUNCTIONS, differences, halved, last_of, momentum


@pytest.mark.parametrize("lanes", [None, 1, 3])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_members_that_go_on_have_the_bits_of_a_whole_training(name, lanes):
    whole = run(FUNCTIONS[name](), AXES, DATA, lanes=lanes)
    assert not differences(halved(name, lanes=lanes), whole)


@pytest.mark.parametrize(("factor", "rungs"), [(2, None), (26, 2), (3, 1), (9, 2), (3, 4)])
def test_wherever_it_is_cut(factor, rungs):
    """A rung of one step among them, whose loop a compiler may take apart."""
    whole = run(momentum(), AXES, DATA, lanes=1)
    found = halved(factor=factor, rungs=rungs, lanes=1)
    assert not differences(found, whole)
    assert last_of(found).sizes[found.steps.dims[0]] == max(1, 14 // factor ** (len(found.attrs["rungs"]) - 1))


OPTIMIZED = """
import os, sys
os.environ["XLA_FLAGS"] = ""
from ovibjax.sweep.engine import run
from tests.sweep.staged_members import AXES, DATA, FUNCTIONS, differences, halved
for name, lanes in (("momentum", 1), ("network", None), ("same_start", 3)):
    whole = run(FUNCTIONS[name](), AXES, DATA, lanes=lanes)
    assert not differences(halved(name, lanes=lanes), whole), (name, lanes)
    assert not differences(halved(name, factor=2, rungs=4, lanes=lanes), whole), (name, lanes)
print("same")
"""


def test_with_optimized_machine_code_too():
    assert finish(start(OPTIMIZED)) == "same\n"


DEVICES = """
import sys
from ovibjax.sweep.engine import run
from tests.sweep.staged_members import AXES, DATA, halved, momentum
halved(store=f"{sys.argv[1]}/h.zarr", lanes=2)
run(momentum(), AXES, DATA, store=f"{sys.argv[1]}/w.zarr", lanes=2)
"""


def test_on_several_devices(tmp_path):
    finish(start(DEVICES, tmp_path, devices=3, threads=3))
    at_three = open_dataset(tmp_path / "h.zarr")
    assert not differences(at_three, open_dataset(tmp_path / "w.zarr"))
    assert not differences(at_three, run(momentum(), AXES, DATA, lanes=2))


def test_data_that_differ_along_an_axis():
    def begin(key, point, shared):
        return jnp.zeros(4)

    def go_on(key, point, shared, state, first, last):
        return jax.lax.fori_loop(first, last, lambda i, w: w + point["rate"] * (shared - w), state)

    fn = Staged(begin, go_on, lambda key, point, shared, state: {"loss": jnp.sum(state)}, 9)
    axes = {"scene": ["a", "b", "c"], "rate": [0.1, 0.2, 0.3], "seed": range(2)}
    for axis, n in (("scene", 3), ("seed", 2)):
        data = Along(axis, [np.float32([i, 2, 3, 4]) for i in range(n)])
        for lanes in (None, 2):
            found, whole = halve(fn, axes, data, score="loss", lanes=lanes), run(fn, axes, data, lanes=lanes)
            assert not differences(found, whole, ("scene", "rate"), 9)
    with pytest.raises(InputError, match="not one entry per value"):
        halve(fn, axes, Along("scene", data.values[:2]), score="loss")


def test_a_state_keeps_its_form():
    def begin(key, point, shared):
        return {"a": jnp.zeros(3), "n": 0}

    def go_on(changed):
        return Staged(begin, lambda key, point, shared, state, first, last: changed(state), lambda *_: {"y": 1.0}, 4)

    form = form_of(go_on(lambda state: state), {"x": np.float32(1)}, None)
    assert form.nbytes == 16 and form.keys == (None, None)
    for changed, words in (
        (lambda state: {"a": state["a"], "n": 1.5}, r"int32\[\] becomes float32\[\]"),
        (lambda state: {"a": jnp.zeros(4), "n": 0}, r"float32\[3\] becomes float32\[4\]"),
        (lambda state: {"a": state["a"]}, "becomes"),
    ):
        with pytest.raises(InputError, match=f"go_on gives a state of another form than it is given: .*{words}"):
            run(go_on(changed), {"x": [1.0, 2.0]})
    for steps, every in ((0, 1), (4, 0), (5, 2), (-4, 2)):
        with pytest.raises(InputError, match="cannot be cut"):
            Staged(begin, begin, begin, steps, every)
