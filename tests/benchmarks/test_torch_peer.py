"""The PyTorch peer of the training benchmarks computes the same objective, gradients and steps as the product."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.encoder import epochs, model
from ovibjax.encoder import linear_start as start_module
from ovibjax.encoder import train as train_module
from ovibjax.encoder.loss import make_hypers
from ovibjax.encoder.model import dense_layers
from ovibjax.encoder.train import TrainConfig, view_rows
from tests.encoder.cases import (
    TERMS,
    UAV,
    UGV,
    assert_trees_close,
    assert_trees_equal,
    differentiate,
    make_data,
    make_params,
    stratified_batch,
    train,
)

COMPLETING, COMPLETING_UGV = (
    dataclasses.replace(arch, kind="completing", rank=20, last_hidden=20) for arch in (UAV, UGV)
)
# One program each, not one for every operation in them.
init = jax.jit(model.init, static_argnums=1)
linear_start = jax.jit(start_module.linear_start, static_argnums=2)
sample_batch = jax.jit(train_module.sample_batch, static_argnums=3)
ARCHES = [UAV, UGV, COMPLETING, COMPLETING_UGV]


@pytest.fixture(scope="module")
def peer():
    """Imported when a test runs: torch takes seconds, which collection need not wait for."""
    torch = pytest.importorskip("torch")
    # Threads that wait for each other on busy cores take far longer than one.
    torch.set_num_threads(1)
    from tests.benchmarks import torch_peer

    return torch_peer


def tensors_of(peer, batch):
    import torch

    return peer.Batch(**{name: torch.tensor(np.asarray(leaf)) for name, leaf in batch._asdict().items()})


@pytest.mark.parametrize("prior", ["gaussian", "ard"])
@pytest.mark.parametrize("arch", ARCHES)
def test_loss_terms_and_gradients_equal_those_of_the_product(peer, arch, prior):
    static, weights = TrainConfig(arch=arch), {"alpha": 1.3, "beta": 0.02, "gamma": 0.7}
    params, batch = make_params(arch), stratified_batch(static, 11)
    rows = view_rows(static, 11)[1]
    (want, terms), grads = differentiate(params, batch, make_hypers(**weights), arch, prior, rows)
    network = peer.OVIB(arch)
    peer.load_params(network, params)
    got, got_terms = peer.composite_loss(network, tensors_of(peer, batch), weights, prior)
    got.backward()
    np.testing.assert_allclose(got.item(), want, rtol=1e-5)
    for name in TERMS:
        np.testing.assert_allclose(got_terms[name].item(), terms[name], rtol=1e-5, err_msg=name)
    layers = dense_layers(grads)
    assert sorted(layers) == sorted(name for name, _ in network.named_children())
    for name, layer in network.named_children():
        assert ("bias" in layers[name]) == (layer.bias is not None)
        for key, ours in layers[name].items():
            theirs = layer.weight.grad.T if key == "kernel" else layer.bias.grad
            np.testing.assert_allclose(theirs, ours, rtol=1e-4, atol=3e-5 * np.abs(ours).max(), err_msg=name)


@pytest.mark.parametrize("arch", ARCHES)
def test_parameters_survive_the_way_there_and_back(peer, arch):
    network = peer.OVIB(arch)
    peer.load_params(network, make_params(arch))
    assert_trees_equal(peer.flax_params(network), make_params(arch))


@pytest.mark.parametrize("arch", [UAV, COMPLETING])
def test_initial_weights_have_the_distribution_of_the_product(peer, arch):
    import torch

    network = peer.OVIB(arch)
    draws = []
    for seed in range(30):
        peer.initialise(network, torch.Generator().manual_seed(seed))
        draws.append([layer.weight.detach().numpy().copy() for layer in network.children()])
    numerators = dict.fromkeys(("mean", "descriptor", "head_2"), 1.0) | {
        "logvar": 0.01,
        "direct": 0.0,
        "principal": 0.0,
    }
    if arch.linear:
        numerators |= {"encoder_2": 0.02, "completion": 0.01}
    for (name, layer), *weights in zip(network.named_children(), *draws, strict=True):
        variance = numerators.get(name, 2.0) / layer.in_features
        np.testing.assert_allclose(np.std(weights), np.sqrt(variance), rtol=0.1, err_msg=name)
        if layer.bias is not None:
            np.testing.assert_array_equal(layer.bias.detach(), arch.logvar_bias if name == "logvar" else 0.0)


def test_the_linear_start_is_that_of_the_product(peer):
    import torch

    data, params = make_data(), make_params(COMPLETING)
    network = peer.OVIB(COMPLETING)
    peer.load_params(network, params)
    peer.linear_start(network, torch.tensor(np.asarray(data.x)))
    want = linear_start(params, data.x, COMPLETING)
    assert_trees_close(peer.flax_params(network), want, rtol=0, atol=1e-3)


@pytest.mark.parametrize(("warmup", "total"), [(10, 60), (10, 21), (1, 3)])
def test_the_rate_rises_and_falls_as_in_the_product(peer, warmup, total):
    import torch

    optimizer = epochs.make_optimizer(make_hypers(lr=1.0, weight_decay=0.0), warmup, total)

    def step(state, _):
        # Adam moves by the learning rate where the gradient is always the same.
        with jax.numpy_dtype_promotion("standard"):
            update, state = optimizer.update(jnp.ones(()), state, jnp.zeros(()))
        return state, -update

    _, want = jax.lax.scan(step, optimizer.init(jnp.zeros(())), length=total)
    for decay in ("linear", "cosine"):
        theirs = torch.optim.SGD([torch.zeros((), requires_grad=True)], lr=1.0)
        scheduler, got = peer.make_scheduler(theirs, warmup, total, decay), []
        for _ in range(total):
            got.append(scheduler.get_last_lr()[0])
            theirs.step()
            scheduler.step()
        if decay == "linear":
            np.testing.assert_allclose(got, want, rtol=1e-3)
        else:
            rise = max(1, min(warmup, total // 5))
            fall = 0.5 * (1 + np.cos(np.pi * (np.arange(total) - rise).clip(0) / (total - rise)))
            np.testing.assert_allclose(got, np.minimum((np.arange(total) + 1) / rise, fall), rtol=1e-6)


@pytest.mark.parametrize("arch", [UAV, COMPLETING])
def test_on_the_same_batches_it_ends_where_fit_ends(peer, arch):
    # A norm that some gradients exceed and others do not.
    static = TrainConfig(arch=arch, prefixes=(2, 5, 8), steps=12, batch=32, warmup=4, clip=6.0, linear_lr=0.25)
    key, hypers, data = jax.random.key(3), make_hypers(lr=3e-3, weight_decay=0.1), make_data()
    want, _ = train(key, hypers, data, static)
    key_init, key_order, key_steps = jax.random.split(key, 3)
    network = peer.OVIB(arch)
    peer.load_params(network, linear_start(init(key_init, arch), data.x, arch))
    start = peer.flax_params(network)
    numbers = peer.as_numbers(hypers)
    optimizer = peer.make_optimizer(network, numbers, static)
    scheduler = peer.make_scheduler(optimizer, static.warmup, static.steps)
    for count in range(static.steps):
        order = jax.random.permutation(jax.random.fold_in(key_order, count // 2), 64)
        key_batch = jax.random.split(jax.random.fold_in(key_steps, count))[0]
        batch = sample_batch(key_batch, order.reshape(2, 32)[count % 2], data, static)
        peer.train_step(network, optimizer, tensors_of(peer, batch), numbers, static)
        scheduler.step()
    got = peer.flax_params(network)
    assert_trees_close(got, want, rtol=0, atol=2e-4)
    moved = jax.tree.map(lambda a, b: float(jnp.abs(a - b).max()), got, start)
    assert min(jax.tree.leaves(moved)) > 2e-3


@pytest.mark.parametrize("bfloat16", [False, True])
@pytest.mark.parametrize("arch", [UAV, COMPLETING])
def test_a_member_trains(peer, arch, bfloat16):
    data = make_data()
    hypers = {"alpha": 1.0, "beta": 1e-3, "gamma": 0.1, "lr": 1e-2, "weight_decay": 1e-4}
    static = TrainConfig(arch=arch, prefixes=(2, 5, 8), batch=32, warmup=10)
    (_, short), (network, long) = (
        peer.train_member(0, hypers, data.x, data.y, dataclasses.replace(static, steps=steps), bfloat16=bfloat16)
        for steps in (2, 200)
    )
    assert sorted(long) == sorted([*TERMS, "loss"])
    assert long["loss"] < 0.6 * short["loss"] and np.isfinite(list(long.values())).all()
    assert all(leaf.dtype == jnp.float32 for leaf in jax.tree.leaves(peer.flax_params(network)))
