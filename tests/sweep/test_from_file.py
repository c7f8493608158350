"""Sweep files: what they may define, what is refused by name, and axes with other values than the file's."""

import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.sweep.engine import run
from ovibjax.sweep.from_file import data_of, member_of, read_sweep_file
from ovibjax.sweep.grid import Axis
from ovibjax.sweep.work import Along

GOOD = """
import jax.numpy as jnp
import numpy as np
from ovibjax.sweep import Along, Axis
axes = {"a": [0.5, 1.0, 2.0], "kind": ["none", "half", "full"], "seed": range(3)}
def member(key, point, shared):
    return {"y": point["a"] * jnp.float32(10) + point["kind"].astype(jnp.float32)}
"""


@pytest.fixture
def written(tmp_path):
    def write(text):
        path = tmp_path / "mine.py"
        path.write_text(text)
        return read_sweep_file(path)

    return write


def computed(file, **asked):
    """The sweep of a file, with other values of some axes."""
    names = {"kind": list(file.axes["kind"].values)} if "kind" in file.axes else {}
    axes = dict(file.axes)
    for name, values in asked.items():
        axes[name] = Axis(tuple(values), numbers=[names[name].index(v) for v in values] if name in names else None)
    return run(member_of(file), axes, data_of(file, axes), **file.options)


def refusal(function, *arguments, **options):
    with pytest.raises(InputError) as caught:
        function(*arguments, **options)
    said = str(caught.value)
    assert "mine.py: " in said and "\n" not in said and len(said) < 600, said
    return said


def test_everything_a_file_may_define(written):
    more = """
axes = {"a": Axis((0.5, 1.0), "m"), "b": [1, 2], "seed": [3]}
zipped = ["a", "b"]
dims, coords, units = {"wave": "t"}, {"t": [0.0, 0.1]}, {"wave": "V"}
static, settings = {"steps": 3}, {"note": "x"}
shared = {"gain": np.float32(2)}
def member(key, point, shared):
    return {"wave": shared["gain"] * point["a"] * jnp.arange(2, dtype=jnp.float32)}
"""
    dataset = computed(written(GOOD + more))
    assert dict(dataset.sizes) == {"a_b": 2, "seed": 1, "t": 2} and dataset.wave.attrs["units"] == "V"
    assert dataset.wave.values[:, 0].tolist() == [[0, 1], [0, 2]] and dataset.t.values.tolist() == [0, 0.1]
    config = dataset.attrs["config"]
    assert config["settings"] == {"steps": 3, "note": "x"} and config["function"] == "sweep_file.mine.member"


def test_names_keep_their_place_in_the_file(written):
    file = written(GOOD)
    whole, part = computed(file), computed(file, kind=["full", "half"], a=[1.0])
    assert part.y.dims == ("a", "kind", "seed") and part.kind.values.tolist() == ["full", "half"]
    assert part.y.values[0, :, 0].tolist() == [12, 11]
    assert whole.y.sel(a=1.0, kind=["full", "half"]).values.tolist() == part.y.values[0].tolist()


def test_the_program_is_the_files_whatever_values_are_asked_for(written):
    file = written(GOOD)
    one, other = (computed(file, a=values, seed=[7]).attrs["config"]["program"] for values in ([1.0, 2.0], [3.0, 4.0]))
    changed = computed(written(GOOD.replace("(10)", "(11)")), a=[1.0, 2.0], seed=[7]).attrs["config"]["program"]
    assert one == other != changed


def test_data_follow_the_values_asked_for(written):
    fixed = written(GOOD + "shared = lambda: Along('seed', [np.full(2, s) for s in range(3)])\n")
    asked = {**fixed.axes, "seed": Axis((2, 0))}
    assert [entry.tolist() for entry in data_of(fixed, asked).values] == [[2, 2], [0, 0]]
    said = refusal(data_of, fixed, {**fixed.axes, "seed": Axis((0, 7))})
    assert "shared() has no data for seed 7" in said and "shared(axes)" in said
    free = written(GOOD + "def shared(axes):\n    return Along('seed', [np.full(2, s) for s in axes['seed']])\n")
    assert [entry.tolist() for entry in data_of(free, {**free.axes, "seed": Axis((7,))}).values] == [[7, 7]]
    both = data_of(written(GOOD + "def shared(n=2, axes=None):\n    return np.arange(n * len(axes))\n"), asked)
    assert isinstance(both, np.ndarray) and not isinstance(both, Along) and both.shape == (6,)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("axes = {'a': [1]}", "member is missing; a sweep file defines axes"),
        ("def member(key, point, shared): ...", "axes is missing"),
        (GOOD + "axes = [1, 2]", "axes is a list; it is a dictionary by name"),
        (GOOD + "axes = {1: [1]}", "axes: 1 is not a name"),
        (GOOD + "axes = {'a': []}", "axis a has no values"),
        (GOOD + "axes = {'a': [1, None]}", "axis a: values are numbers or names"),
        (GOOD + "axes = {'a': Axis(3.0)}", "axes: a is a float; it is a list"),
        (GOOD + "member = 3", "member is an int, not a function"),
        (GOOD + "def member(key, point): ...", "member(key, point) takes other arguments; write member(key, point, s"),
        (GOOD + "units = 'm'", "units is a str; it is a dictionary"),
        (GOOD + "units = {'y': 3}", "units: that of y is an int, not text"),
        (GOOD + "dims = {'y': 3}", "dims: those of y are an int"),
        (GOOD + "coords = {'t': 3}", "coords: t is an int; it is a list"),
        (GOOD + "coords = {'t': [[1], [1, 2]]}", "coords: t is a list"),
        (GOOD + "zipped = 'a'", "zipped is a str"),
        (GOOD + "zipped = [['a', 'b']]", "zipped axis 'b' is not in the grid"),
        (GOOD + "zipped = [['a', 'kind'], 3]", "zipped: groups are an int"),
        (GOOD + "settings = {'x': np.ones(2)}", "settings: Object of type ndarray is not JSON serializable"),
    ],
)
def test_a_wrong_definition_is_named(written, text, words):
    assert words in refusal(written, text)


@pytest.mark.parametrize(
    ("shared", "words"),
    [
        ("def shared(n): ...", "shared(n) takes other arguments; write shared()"),
        ("def shared():\n    return open('none.csv')", "shared fails: mine.py, line 9: FileNotFoundError"),
        ("shared = {'x': {'y': 'text'}}", "shared['x']['y'] is a str; data are arrays of numbers"),
        ("shared = {'x': np.array(['text'])}", "shared['x'] is a ndarray"),
        ("import jax\nshared = [jax.random.key(0)]", "shared[0] is"),
        ("shared = Along('scene', [1.0])", "shared differs along 'scene'; the axes are a, kind, seed"),
        ("shared = Along('seed', [1.0])", "shared has 1 entries along axis seed, which has 3 values"),
        ("shared = Along('seed', [np.ones(2), np.ones(2), np.ones(3)])", "entry 2 along axis seed has other shapes"),
        ("shared = Along('seed', [1.0, {}, print])", "shared: entry 1 along axis seed has other"),
    ],
)
def test_wrong_data_are_named(written, shared, words):
    file = written(GOOD + shared)
    assert words in refusal(data_of, file, file.axes)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("if point['a'] > 1: return {}", "member cannot be traced: it branches on an array"),
        ("return {'y': np.sin(point['a'])}", "(mine.py, line 9: TracerArrayConversionError"),
        ("return {'y': float(point['a'])}", "use jax.numpy"),
        ("return {'y': point['gamma']}", "line 9: KeyError: 'gamma' (a point has a, kind, seed)"),
        ("return {'y': jnp.ones(2) @ jnp.ones(3)}", "member fails: mine.py, line 9: TypeError"),
        ("raise RuntimeError('mine')", "member fails: mine.py, line 9: RuntimeError: mine"),
        ("return point['a']", "it returns a dictionary of arrays by name"),
        ("pass", "member returns nothing"),
        ("return {'y': 'text'}", "member returns a str as y; outputs are arrays of numbers"),
        ("return {'y': {'z': None}}", "member returns a NoneType as y.z"),
    ],
)
def test_a_wrong_member_is_named(written, body, words):
    file = written(f"{GOOD}def member(key, point, shared):\n    {body}\n")
    assert words in refusal(computed, file)
