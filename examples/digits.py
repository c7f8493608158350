"""Logistic regression on scikit-learn's digits, trained and tested at every point of a grid of settings."""

import jax
import jax.numpy as jnp

settings = {"steps": 200, "tested": 450}
axes = {"l2": [1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0], "rate": [0.3, 1.0, 3.0], "seed": range(5)}
dims, coords = {"loss": ["step"]}, {"step": range(settings["steps"])}


def shared():
    """Images, 64 numbers from 0 to 1 each, and the digits they show."""
    from sklearn.datasets import load_digits

    pixels, digits = load_digits(return_X_y=True)
    return {"x": jnp.float32(pixels / 16), "y": jnp.int32(digits)}


def loss(weights, data, l2):
    """Mean cross-entropy, with a penalty."""
    scores = jax.nn.log_softmax(data["x"] @ weights)
    return -jnp.take_along_axis(scores, data["y"][:, None], axis=1).mean() + l2 / 2 * (weights**2).sum()


def accuracy(weights, data):
    """Share of the images that are told right."""
    return ((data["x"] @ weights).argmax(axis=1) == data["y"]).mean()


def member(key, point, shared):
    """Gradient descent on the images that the seed draws, and how well it does on the others."""
    order = jax.random.permutation(key, len(shared["y"]))
    parts = jnp.split(order, [settings["tested"]])
    test, train = ({name: array[part] for name, array in shared.items()} for part in parts)

    def step(weights, _):
        value, slope = jax.value_and_grad(loss)(weights, train, point["l2"])
        return weights - point["rate"] * slope, value

    weights, losses = jax.lax.scan(step, jnp.zeros((64, 10)), length=settings["steps"])
    return {"loss": losses, "train_accuracy": accuracy(weights, train), "test_accuracy": accuracy(weights, test)}
