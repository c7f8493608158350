"""The PyTorch peer of the training benchmark computes the same objective and gradients as the product."""

import numpy as np
import pytest

from ovibjax.encoder.loss import make_hypers
from ovibjax.encoder.model import dense_layers
from ovibjax.encoder.train import TrainConfig, view_rows
from tests.encoder.cases import TERMS, UAV, UGV, differentiate, make_data, make_params, stratified_batch


@pytest.fixture(scope="module")
def peer():
    """Imported when a test runs: torch takes seconds, which collection need not wait for."""
    torch = pytest.importorskip("torch")
    # Threads that wait for each other on busy cores take far longer than one.
    torch.set_num_threads(1)
    from tests.benchmarks import torch_peer

    return torch_peer


@pytest.mark.parametrize("prior", ["gaussian", "ard"])
@pytest.mark.parametrize("arch", [UAV, UGV])
def test_loss_terms_and_gradients_equal_those_of_the_product(peer, arch, prior):
    import torch

    static, weights = TrainConfig(arch=arch), {"alpha": 1.3, "beta": 0.02, "gamma": 0.7}
    params, batch = make_params(arch), stratified_batch(static, 11)
    rows = view_rows(static, 11)[1]
    (want, terms), grads = differentiate(params, batch, make_hypers(**weights), arch, prior, rows)
    network = peer.OVIB(arch)
    peer.load_params(network, params)
    tensors = peer.Batch(**{name: torch.tensor(np.asarray(leaf)) for name, leaf in batch._asdict().items()})
    got, got_terms = peer.composite_loss(network, tensors, weights, prior)
    got.backward()
    np.testing.assert_allclose(got.item(), want, rtol=1e-5)
    for name in TERMS:
        np.testing.assert_allclose(got_terms[name].item(), terms[name], rtol=1e-5, err_msg=name)
    layers = dense_layers(grads)
    assert sorted(layers) == sorted(name for name, _ in network.named_children())
    for name, layer in network.named_children():
        for theirs, ours in ((layer.weight.grad.T, layers[name]["kernel"]), (layer.bias.grad, layers[name]["bias"])):
            np.testing.assert_allclose(theirs, ours, rtol=1e-4, atol=1e-5 * np.abs(ours).max(), err_msg=name)


def test_initial_weights_have_the_distribution_of_the_product(peer):
    import torch

    arch = UAV
    network = peer.OVIB(arch)
    peer.initialise(network, arch, torch.Generator().manual_seed(0))
    draws = []
    for seed in range(30):
        peer.initialise(network, arch, torch.Generator().manual_seed(seed))
        draws.append([layer.weight.detach().numpy().copy() for layer in network.children()])
    linear = {"mean", "descriptor", "head_2"}
    for (name, layer), *weights in zip(network.named_children(), *draws, strict=True):
        variance = (0.01 if name == "logvar" else 1.0 if name in linear else 2.0) / layer.in_features
        np.testing.assert_allclose(np.std(weights), np.sqrt(variance), rtol=0.1, err_msg=name)
        np.testing.assert_array_equal(layer.bias.detach(), arch.logvar_bias if name == "logvar" else 0.0)


@pytest.mark.parametrize("bfloat16", [False, True])
def test_a_member_trains(peer, bfloat16):
    data = make_data()
    hypers = {"alpha": 1.0, "beta": 1e-3, "gamma": 0.1, "lr": 1e-2, "weight_decay": 1e-4}
    static = TrainConfig(arch=UAV, prefixes=(2, 5, 8), batch=32, warmup=10)
    short, long = (
        peer.train_member(0, hypers, data.x, data.y, TrainConfig(**{**vars(static), "steps": steps}), bfloat16=bfloat16)
        for steps in (2, 200)
    )
    assert sorted(long) == sorted([*TERMS, "loss"])
    assert long["loss"] < 0.6 * short["loss"] and np.isfinite(list(long.values())).all()
