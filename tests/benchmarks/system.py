"""The whole system on a grid: one compiled program against the usual Python loop over its parts, in the same run.

    python -m tests.benchmarks.system            (extra [bench]; a quiet machine; about four minutes)

The loop reuses stages as ours does: PyTorch trains once per (beta, gamma, seed), NumPy encodes and retrieves once per
prefix, a Python loop replays each client once per prefix, SimPy serves each server once per rule, and Base-DPP once per
V. Each part is timed on a sample and multiplied by how often the grid needs it; the arithmetic is printed.

2 virtual cores with AVX2, quiet, Python 3.11, jax 0.10.2, torch 2.13.0; 1,080 points x 5 rules:

    ovibjax: 8.27 s a member on all cores, 45 members: 372 s
    PyTorch training: 45 x 15.4 s = 695 s
    NumPy retrieval: 45 x 4 x 0.29 s = 51 s
    Python replay: 45 x 4 x 6 x 0.04 s = 42 s
    SimPy: 45 x 4 x 6 servers x 10 replays = 183 s
    in all 971 s
    ratio: 2.6

NumPy retrieved the same reference in every frame and mode, the Python replay sent in the same slots, and SimPy's waits
agreed within a microsecond. The goal of 20 is not met: training dominates both sides, and XLA trains one member about
twice as fast as eager PyTorch on these cores; what lies behind it costs the usual way 276 s.
"""

import argparse
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jax
import jax.numpy as jnp
import numpy as np
import torch

from ovibjax.control.actions import ActionSet, SweptActions
from ovibjax.control.client_state import ControlParams
from ovibjax.control.drives import embedded_drives
from ovibjax.control.environment import draw
from ovibjax.control.residuals import encode_views
from ovibjax.control.route_replay import simulate
from ovibjax.encoder.checkpoint import mix_frames
from ovibjax.encoder.loss import LR
from ovibjax.encoder.model import dense_layers
from ovibjax.scheduling.queue_replay import waits
from ovibjax.scheduling.requests import RequestTrace
from ovibjax.scheduling.rules import POLICIES, default_params
from ovibjax.system import stages
from ovibjax.system.data import SystemData, SystemSize, make_system
from ovibjax.system.grids import sweep_system
from ovibjax.views import mode_mask
from tests.benchmarks.scheduler import simpy_replay
from tests.benchmarks.torch_peer import train_member
from tests.control.cases import for_oracle
from tests.oracles import control as oracle
from tests.oracles import scheduling as queue

BETAS, GAMMAS, KS, SEEDS = (1e-4, 1e-3, 1e-2), (0.0, 0.1, 1.0), (8, 16, 32, 64), (100, 101, 102, 103, 104)
VS = (0.0, 1.0, 4.0, 8.0, 16.0, 64.0)
TRAINING_ROUTES = 3


def numpy_retrieval(params: Any, data: SystemData, masks: np.ndarray, k: int) -> np.ndarray:
    """[A, F] retrieved references, leave one out, as one writes it in NumPy."""
    layers = {name: jax.tree.map(np.asarray, layer) for name, layer in dense_layers(params).items()}
    x = np.asarray(data.x).reshape(len(data.x), -1)
    references, own = np.asarray(data.survey.rows), np.asarray(data.survey.own)

    def dense(name: str, h: np.ndarray) -> np.ndarray:
        return h @ layers[name]["kernel"] + layers[name].get("bias", np.float32(0.0))

    def gelu(h: np.ndarray) -> np.ndarray:
        return 0.5 * h * (1.0 + np.tanh(np.sqrt(2.0 / np.pi, dtype=np.float32) * (h + 0.044715 * h**3)))

    found = []
    for mask in masks:
        wide = np.repeat(mask, x.shape[1] // len(mask))
        kept = x * wide
        mu = dense("mean", dense("encoder_2", gelu(dense("encoder_1", kept))) + dense("direct", kept))
        mu[:, k:] = 0.0
        coordinates = dense("completion", gelu(dense("decoder_2", np.sin(dense("decoder_1", mu)))))
        coordinates[:, :k] = mu[:, :k]
        descriptor = dense("principal", coordinates) * wide
        unit = kept[references] / np.linalg.norm(kept[references], axis=1, keepdims=True)
        similarity = descriptor @ unit.T
        rows = np.flatnonzero(own >= 0)
        similarity[rows, own[rows]] = -np.inf
        found.append(similarity.argmax(axis=1))
    return np.stack(found)


def timed(work: Callable[[], Any], repeats: int = 3) -> tuple[Any, float]:
    """A result, and the least wall-clock seconds."""
    best, result = float("inf"), None
    for _ in range(repeats):
        start = time.perf_counter()
        result = work()
        best = min(best, time.perf_counter() - start)
    return result, best


def main() -> None:
    """Time both ways and print the arithmetic and the ratio."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=SystemSize().steps, help="training steps (default: the figure's)")
    parser.add_argument("--members", type=int, default=8, help="members of ours that are timed (default 8)")
    parser.add_argument("--threads", type=int, default=os.cpu_count(), help="threads of PyTorch (default: cores)")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    print(f"{os.cpu_count()} cores, load {load:.1f}, jax {jax.__version__}, torch {torch.__version__}")
    size = SystemSize(options.steps)
    scene = embedded_drives(), TRAINING_ROUTES, size
    data, static = make_system(*scene)
    members = len(BETAS) * len(GAMMAS) * len(SEEDS)
    points = members * len(KS) * len(VS)

    # Ours: the clock starts when the program is compiled, at the first report of progress.
    seeds = list(range(SEEDS[0], SEEDS[0] + options.members))
    reported: list[float] = []
    began = time.perf_counter()
    along = (KS, VS, POLICIES)
    sweep_system(scene, {"beta": [1e-3], "gamma": [0.1], "seed": [99]}, along)
    compile_s = time.perf_counter() - began
    sweep_system(
        scene,
        {"beta": [1e-3], "gamma": [0.1], "seed": seeds},
        along,
        on_progress=lambda *_: reported.append(time.perf_counter()),
    )
    member_s = (reported[-1] - reported[0]) / options.members
    ours_s = members * member_s
    print(f"ovibjax: {member_s:.2f} s a member on all cores, {members} members: {ours_s:.0f} s")
    print(f"         (the first member alone, compiling included: {compile_s:.0f} s)")

    # Theirs, part by part, on the stages of one of our members.
    point = {"beta": jnp.float32(1e-3), "gamma": jnp.float32(0.1)}
    key = jax.random.key(SEEDS[0])
    train_key, route_key, queue_key = jax.random.split(key, 3)
    hypers = {"alpha": 0.0, "beta": 1e-3, "gamma": 0.1, "lr": LR, "weight_decay": 1e-4}
    mixed = np.asarray(mix_frames(train_key, data.seen_x, static.mixed))
    _, train_s = timed(
        lambda: train_member(0, hypers, mixed, np.zeros((len(mixed), 3), np.float32), static.train), repeats=1
    )
    params = jax.jit(stages.train, static_argnames="static")(train_key, point, data, static)
    masks = np.stack([np.asarray(mode_mask(mode, 5)) for mode in static.modes])
    k = 16
    retrieved, retrieve_s = timed(lambda: numpy_retrieval(params, data, masks, k))
    actions = SweptActions(modes=static.modes, k=jnp.int32(k))
    flat = data.x.reshape(len(data.x), -1)
    codes = jnp.stack([encode_views(params, flat, jnp.asarray(mask), static.train.arch) for mask in masks])
    routes, _ = stages.localize(params, codes, jnp.asarray(masks), jnp.int32(k), data, static)
    places = np.asarray(data.survey.places_m)
    theirs = (places[retrieved] - np.asarray(data.positions_m)).transpose(1, 0, 2)[np.asarray(data.routes)]
    same = float(np.mean(np.all(np.abs(theirs - np.asarray(routes.residual_m)) < 1e-3, axis=-1)))
    print(f"NumPy retrieves what ours does in {100 * same:.2f} % of frames and modes")
    history, _ = stages.replay_clients(route_key, routes, actions, data, static)
    one = jax.tree.map(lambda leaf: leaf[0], routes)
    draws = draw(jax.random.fold_in(route_key, 0), one, data.env, actions)
    params_control = ControlParams(data.env, data.control)
    static_actions = ActionSet(static.modes, (k,))
    arguments = for_oracle(draws, one, params_control, static_actions)
    replayed, replay_s = timed(lambda: oracle.replay("voi", *arguments), repeats=1)
    ours_sent = np.asarray(simulate(draws, one, "voi", params_control, actions).sent)
    agree = bool(np.array_equal(np.asarray(replayed["sent"], bool), ours_sent))
    print(f"The Python replay sends in the same slots: {agree}")
    workload = stages.arrivals(queue_key, history, routes, actions, data, static)
    trace = RequestTrace(*(np.asarray(leaf)[0] for leaf in workload.requests))
    keep = np.asarray(trace.valid)
    trace = RequestTrace(*(leaf[keep] for leaf in trace))
    serve_s = {}
    for rule in POLICIES:
        got, serve_s[rule] = timed(lambda rule=rule: simpy_replay(trace, rule, queue.PAPER_V, queue.PAPER_WEIGHTS), 1)
        worst = float(np.max(np.abs(got - np.asarray(waits(trace, rule, default_params())))))
        print(f"SimPy serves {keep.sum()} requests by {rule} in {serve_s[rule]:.2f} s, waits within {worst:.3f} ms")
    replays = {rule: len(VS) if rule == "base_dpp" else 1 for rule in POLICIES}
    servers = len(data.fleet)
    parts = {
        f"PyTorch training: {members} x {train_s:.1f} s": members * train_s,
        f"NumPy retrieval: {members} x {len(KS)} x {retrieve_s:.2f} s": members * len(KS) * retrieve_s,
        f"Python replay: {members} x {len(KS)} x {size.clients} x {replay_s:.2f} s": members
        * len(KS)
        * size.clients
        * replay_s,
        f"SimPy: {members} x {len(KS)} x {servers} servers x {sum(replays.values())} replays": members
        * len(KS)
        * servers
        * sum(serve_s[rule] * count for rule, count in replays.items()),
    }
    print(f"\nthe usual way, {points} points x {len(POLICIES)} rules:")
    for text, seconds in parts.items():
        print(f"  {text} = {seconds:.0f} s")
    theirs_s = sum(parts.values())
    print(f"  in all {theirs_s:.0f} s; ovibjax {ours_s:.0f} s, compiling apart")
    print(f"ratio: {theirs_s / ours_s:.1f}")


if __name__ == "__main__":
    main()
