"""Whole grids in compiled calls: describe a grid, run it, store it, resume it, spread it, read it (`sweep.open`).

A tool of its own, which knows nothing of what is computed. A *member function* of jax is computed at every point of a
grid of named axes; all points are one compiled program, and come back as one labelled dataset:

>>> import jax
>>> from ovibjax import sweep
>>> def member(key, point, shared):
...     return {"cost": (point["beta"] - shared["best"]) ** 2 + 0.1 * jax.random.normal(key)}
>>> axes = {"beta": [0.0, 1.0, 2.0], "seed": range(4)}
>>> dataset = sweep.run(member, axes, {"best": 1.0}, units={"cost": "m"})
>>> dict(dataset.sizes), dataset.cost.attrs["units"]
({'beta': 3, 'seed': 4}, 'm')
>>> dataset.cost.mean("seed").idxmin().item()
1.0

`point` has the member's value on every axis: floats as float32, whole numbers as int32, names as their place in the
list. `key` follows the axis `seed`, so that members of one seed draw the same numbers and differences between them
are paired. `shared` are data for all members; `Along` gives data per value of one axis. Outputs are arrays by name, of
any shape; `dims`, `coords` and `units` label them. Members that are not finite are marked `diverged`.

Where a grid of many axes would be too large, `sobol` and `random_points` draw points from ranges, which advance
together:

>>> points = sweep.sobol({"beta": sweep.Range(1e-3, 10, log=True), "rate": sweep.Range(0, 1)}, 8)
>>> dataset = sweep.run(member, {**points, "seed": range(4)}, {"best": 1.0}, zipped=[list(points)])
>>> dict(dataset.sizes), bool(dataset.cost.mean("seed").min() < 0.5)
({'beta_rate': 8, 'seed': 4}, True)

`halve` trains all points for a while and goes on with the best third, of a member function in stages (`Staged`): bit
for bit what `run` gives for them, at a fraction of the steps.

With `store="x.zarr"` members are on disk within a second of being computed; the same call goes on after a kill and
ends with the same bits, and another grid reads what the store has and adds what it lacks. A call that would compute
something else is refused with what differs. `shard=(3, 16)` computes a sixteenth, `merge` joins stores,
`executor=on_ray()` computes members on a cluster, and several jax devices share them by themselves. Afterwards:

- `open(path)` reads a store, also while it is being written; `config_of(path)` says what it holds.
- `tree_of` makes a nested output (parameters, say) a tree again; `best` and `take` pick a member of it.

The same from the shell, for a function in a file (`from_file.py`): `ovibjax sweep run mine.py --out x.zarr`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
