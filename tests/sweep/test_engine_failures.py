"""Members that diverge, what is refused before it is computed, errors, and Ctrl-C."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.sweep.engine import Interrupted, run
from ovibjax.sweep.store import open_dataset
from ovibjax.sweep.work import Along
from tests.sweep.members import finish, small, start


def unstable(key, point, shared):
    noise = jax.random.normal(key, (8,))
    x = jax.lax.fori_loop(0, 50, lambda i, x: point["rate"] * x * x - x + noise, noise)
    return {"x": x, "norm": jnp.sqrt(point["rate"]) * noise[0], "n": jnp.int32(3), "ok": x[0] > 0}


@pytest.mark.parametrize("options", [{"lanes": 8}, {"lanes": 1}, {"lanes": 2}, {}])
def test_diverged_member_is_marked_and_touches_no_other(options):
    seeds = {"seed": range(3)}

    def fn(key, point, shared):
        return {"x": jnp.log(point["rate"]) + unstable(key, {"rate": point["rate"] * 1e-3}, shared)["x"]}

    for bad in (-1.0, 0.0, 3e38):  # NaN, -inf, NaN from overflow
        good = run(fn, {"rate": [0.01, 0.1, 0.2, 0.3, 0.05], **seeds}, **options)
        ill = run(fn, {"rate": [0.01, 0.1, bad, 0.3, 0.05], **seeds}, **options)
        assert not good.diverged.any() and good.finished.all() and ill.finished.all()
        np.testing.assert_array_equal(ill.diverged, np.arange(5)[:, None] == [[2] * 3] * 5)
        keep = [0, 1, 3, 4]
        assert ill.x.values[keep].tobytes() == good.x.values[keep].tobytes()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float16])
def test_one_number_that_is_not_finite_is_enough(value, dtype):
    def fn(key, point, shared):
        y = jnp.zeros((2, 3), dtype).at[1, 2].set(jnp.where(point["x"] > 1, value, 0).astype(dtype))
        return {"fine": point["x"], "n": jnp.int32(1), "deep": {"y": y}}

    assert run(fn, {"x": [1, 2, 0]}).diverged.values.tolist() == [False, True, False]


@pytest.mark.parametrize(
    "output",
    [
        pytest.param({"y": lambda x: x.astype(jnp.bfloat16)}, id="bfloat16"),
        pytest.param({"y": lambda x: jax.lax.complex(x, x)}, id="complex"),
        pytest.param({"finished": lambda x: x}, id="finished"),
        pytest.param({"diverged": lambda x: x}, id="diverged"),
        pytest.param({"x": lambda x: x}, id="name of an axis"),
        pytest.param({"a.b": lambda x: x, "a": {"b": lambda x: -x}}, id="two of one name"),
    ],
)
def test_outputs_that_cannot_be_held_are_refused_before_they_are_computed(output):
    """In memory as in a store: nothing is lost after hours, nothing overwritten."""
    progress = []
    with pytest.raises(InputError):
        run(
            lambda key, point, shared: jax.tree.map(lambda f: f(point["x"]), output),
            {"x": [1.0, 2.0]},
            on_progress=lambda *n: progress.append(n),
        )
    assert not progress


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"axes": {"rate": []}}, "rate has no values"),
        ({"lanes": 0}, "positive"),
        ({"shard": (3, 2)}, "shards 1/2 to 2/2"),
        ({"shard": (0, 2)}, "shards 1/2 to 2/2"),
        ({"shared": Along("scene", [1.0])}, "'scene'"),
        ({"shared": Along("rate", [{"offset": np.float32(1)}])}, "'rate'"),
        ({"dims": {"wave": ("a", "b")}}, "wave"),
        ({"zipped": [("rate", "other")]}, "'other'"),
        pytest.param({"dims": {"wawe": ("t",)}}, "wawe", id="dims of no output"),
        pytest.param({"units": {"wawe": "m"}}, "wawe", id="units of no output"),
        pytest.param({"axes": {"rate": [1.0], "seed": [0.5]}}, "seed", id="a seed that is no integer"),
    ],
)
def test_bad_input(options, words):
    given_options = {"axes": {"rate": [0.1, 0.2]}, "shared": {"offset": np.float32(1)}, **options}
    with pytest.raises(InputError) as caught:
        run(small, **given_options)
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_errors_of_the_member_function_come_through():
    def broken(key, point, shared):
        raise ZeroDivisionError("mine")

    with pytest.raises(ZeroDivisionError, match="mine"):
        run(broken, {"x": [1, 2]})


INTERRUPT = """
import sys
import numpy as np
from ovibjax.sweep.engine import Interrupted
from tests.sweep.members import sweep

try:
    sweep(sys.argv[1] or None, on_progress=lambda done, total: print(done, total, flush=True))
except Interrupted as stop:
    np.savez(sys.argv[2], **{n: v.values for n, v in stop.dataset.data_vars.items()})
    print("interrupted")
"""


@pytest.mark.parametrize("stored", [False, True])
def test_ctrl_c_keeps_what_is_finished(tmp_path, stored):
    store = tmp_path / "a.zarr" if stored else ""
    process = start(INTERRUPT, store, tmp_path / "kept.npz")
    seen = []
    for line in process.stdout:
        seen.append(tuple(map(int, line.split())))
        if seen[-1][0] >= 7:
            break
    process.send_signal(2)
    lines = finish(process).split("\n")
    assert lines[-2] == "interrupted", lines
    seen += [tuple(map(int, line.split())) for line in lines[:-2]]
    assert [done for done, _ in seen] == list(range(len(seen))) and {total for _, total in seen} == {64}
    with np.load(tmp_path / "kept.npz") as kept:
        finished = kept["finished"]
        assert len(seen) - 1 <= finished.sum() <= len(seen) and finished.sum() < 64
        assert np.isfinite(kept["weights"][finished]).all() and np.isnan(kept["weights"][~finished]).all()
        assert (kept["steps"] == np.where(finished, 9000, 0)).all()
        if stored:
            dataset = open_dataset(store)
            for name, values in dataset.data_vars.items():
                np.testing.assert_array_equal(values.values[dataset.finished.values], kept[name][finished])


def test_interrupted_is_a_keyboard_interrupt():
    def stop(done, total):
        if done == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as caught:
        run(small, {"rate": np.linspace(0, 1, 10)}, {"offset": np.float32(0)}, lanes=2, on_progress=stop)
    assert isinstance(caught.value, Interrupted)
    assert caught.value.dataset.finished.sum() == 4
