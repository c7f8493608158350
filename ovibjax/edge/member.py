"""What an encoder sweep computes at each point of its grid: train and judge, or judge a trained encoder otherwise."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from ovibjax.edge.judging import Trained, judge_prefixes
from ovibjax.edge.localize import errors, summarize
from ovibjax.encoder.attention import AttentionConfig, fit_attention, positions_m
from ovibjax.encoder.bits import code_bits, code_of, trained_for_bits
from ovibjax.encoder.epochs import schedule_of
from ovibjax.encoder.loss import LR, TERMS, Hypers, make_hypers
from ovibjax.encoder.model import Architecture, Params, encode
from ovibjax.encoder.rate import active_dims
from ovibjax.encoder.train import TrainConfig, epoch_of, epochs_of, fit
from ovibjax.encoder.training_data import MemberData
from ovibjax.sweep.staged import Staged
from ovibjax.views import full_mode, mode_mask

UNITS = {"val_mean_m": "m", "test_mean_m": "m", "test_p90_m": "m", "rate": "nats"}
"""Units of the outputs."""

DIMS = dict.fromkeys(("val_mean_m", "test_mean_m", "test_p90_m", "eta"), ("mode", "prefix"))
"""Trailing dimensions of the outputs."""


SCORE = "val_mean_m"
"""The output that points are chosen by: never an error on test frames."""


def labels_of(prior: str) -> dict[str, Any]:
    """Dimensions and units of the outputs of members that are trained with a prior, as `sweep.run` takes them.

    Args:
        prior: one of `loss.PRIORS`.

    Returns:
        `dims` and `units`.
    """
    if prior != "bits":
        return {"dims": DIMS, "units": UNITS}
    return {"dims": DIMS | {"code_bits": ("mode", "prefix")}, "units": UNITS | {"rate": "bits", "code_bits": "bits"}}


@dataclass(frozen=True)
class TrainAndJudge:
    """Train an encoder and judge it: a member function for `sweep.run`; hashable, one object for all points.

    Attributes:
        static: architecture, prior, steps.
        prefixes: prefix lengths to judge at.
        modes: view modes to judge in.
        lr: peak learning rate where it is not an axis.
        keep_params: also return the trained parameters.
    """

    static: TrainConfig
    prefixes: tuple[int, ...]
    modes: tuple[str, ...]
    lr: float = LR
    keep_params: bool = False

    def __call__(self, key: jax.Array, point: dict[str, jax.Array], member: MemberData) -> dict[str, Any]:
        """Train and judge one member.

        Args:
            key: its seed's key.
            point: values of any of `Hypers`' fields; other axes are ignored.
            member: data of its seed.

        Returns:
            Mean validation and test errors, 90th percentile of the test errors and mixing weights
            [modes, prefixes]; terms of the loss in the last epoch; coordinates not pruned. Of a training for bits, also
            the mean length of the rounded codes of test frames under the learned prior, `code_bits` [modes, prefixes].
        """
        params, metrics = fit(key, self._hypers(point), member.train, self.static)
        return self._judged(params, member, metrics)

    def staged(self, n: int) -> Staged:
        """The same in stages, cut at whole epochs; the learning rate follows the schedule of the whole training.

        Args:
            n: training examples of a member.

        Returns:
            A member function for `sweep.halve`.
        """
        _, per_epoch, epochs = schedule_of(self.static.steps, self.static.batch, n)
        name = f"{type(self).__module__}.{type(self).__qualname__}"
        return Staged(self._begin, self._go_on, self._judge, epochs * per_epoch, per_epoch, name)

    def _begin(self, key: jax.Array, point: dict[str, jax.Array], member: MemberData) -> dict[str, Any]:
        """The network before its first epoch, with its optimizer and the terms of a loss that is not yet known."""
        trained = epochs_of(key, self._hypers(point), member.train, self.static)[1]
        return {"trained": trained, "metrics": dict.fromkeys(("loss", *TERMS), jnp.float32(0))}

    # As many as a stage is given.
    def _go_on(
        self,
        key: jax.Array,
        point: dict[str, jax.Array],
        member: MemberData,
        state: dict[str, Any],
        first: jax.Array,
        last: jax.Array,
    ) -> dict[str, Any]:
        """The network after the epochs from one step to another, and the terms of the loss in the last of them."""
        per_epoch = schedule_of(self.static.steps, self.static.batch, member.train.x.shape[0])[1]
        epoch = epoch_of(key, self._hypers(point), member.train, self.static)

        def body(number: jax.Array, state: dict[str, Any]) -> dict[str, Any]:
            trained, metrics = epoch(state["trained"], number)
            return {"trained": trained, "metrics": metrics}

        begun, end = (jax.lax.div(step, jnp.int32(per_epoch)) for step in (first, last))
        return jax.lax.fori_loop(begun, end, body, state)

    def _judge(
        self, key: jax.Array, point: dict[str, jax.Array], member: MemberData, state: dict[str, Any]
    ) -> dict[str, Any]:
        """How good the network of a state is."""
        metrics = {name: value[None] for name, value in state["metrics"].items()}
        return self._judged(state["trained"][0], member, metrics)

    def _hypers(self, point: dict[str, jax.Array]) -> Hypers:
        given = {name: value for name, value in point.items() if name in Hypers._fields}
        return make_hypers(lr=self.lr)._replace(**given)

    def _judged(self, params: Params, member: MemberData, metrics: dict[str, jax.Array]) -> dict[str, Any]:
        """Outputs of a trained network, with metrics [epochs]."""
        arch = self.static.arch
        masks = jnp.stack([mode_mask(mode, arch.n_views) for mode in self.modes])
        lengths = jnp.array(self.prefixes, jnp.int32)
        judged = jax.lax.map(lambda mask: judge_prefixes(Trained(member, params), arch, mask, lengths), masks)
        x = member.val_x.reshape(member.val_x.shape[0], -1)
        outputs: dict[str, Any] = {
            "val_mean_m": jnp.mean(judged.val_error_m, axis=-1),
            "test_mean_m": jnp.mean(judged.test_error_m, axis=-1),
            "test_p90_m": summarize(judged.test_error_m).p90_m,
            "eta": judged.eta,
            "active_dims": active_dims(*encode(params, x, arch)),
            **{name: values[-1] for name, values in metrics.items()},
        }
        if trained_for_bits(params):
            outputs["code_bits"] = jax.lax.map(lambda mask: self._code_bits(params, member.test_x, mask), masks)
        return outputs | ({"params": params["params"]} if self.keep_params else {})

    def _code_bits(self, params: Params, x: jax.Array, mask: jax.Array) -> jax.Array:
        """[prefixes] mean length of the codes of frames x [N, M, r] in one view mode."""
        z = code_of(params, (x * mask[None, :, None]).reshape(x.shape[0], -1), self.static.arch)
        return jnp.cumsum(jnp.mean(code_bits(params, z), axis=0))[jnp.array(self.prefixes) - 1]


@dataclass(frozen=True)
class FuseAndLocate:
    """Train the conference version's attention fusion of views on positions alone, and judge it: a member function.

    Attributes:
        static: widths and steps.
        lr: peak learning rate.
        weight_decay: decoupled weight decay; without much of it the baseline overfits.
    """

    static: AttentionConfig
    lr: float = 3e-3
    weight_decay: float = 0.1

    def __call__(self, key: jax.Array, point: dict[str, jax.Array], member: MemberData) -> dict[str, jax.Array]:
        """Train and judge one member with every view.

        Args:
            key: its seed's key.
            point: unused; the baseline has no hyperparameters that are swept.
            member: data of its seed.

        Returns:
            Mean validation and test errors, the loss of the last epoch.
        """
        hypers = make_hypers(lr=self.lr, weight_decay=self.weight_decay)
        params, metrics = fit_attention(key, hypers, member.train, self.static)
        mask = jnp.ones(self.static.n_views, jnp.float32)

        def error_m(x: jax.Array, truth_m: jax.Array) -> jax.Array:
            return jnp.mean(errors(positions_m(params, x, member.standardizer, mask, self.static), truth_m))

        return {
            "val_mean_m": error_m(member.val_x, member.val_m),
            "test_mean_m": error_m(member.test_x, member.test_m),
            "loss": metrics["loss"][-1],
        }


ORDERINGS = ("learned", *(f"random_{i}" for i in range(1, 9)), "tail_first")
"""Orders in which coordinates are kept: as trained, eight random permutations, last coordinate first."""


@dataclass(frozen=True)
class JudgeOrdering:
    """Judge a trained code whose coordinates are kept in another order than the learned one: a member function.

    Attributes:
        arch: widths of the network.
        prefixes: numbers of coordinates kept.
    """

    arch: Architecture
    prefixes: tuple[int, ...]

    def __call__(self, key: jax.Array, point: dict[str, jax.Array], trained: Trained) -> dict[str, jax.Array]:
        """Judge one ordering with every view.

        Args:
            key: unused; permutations are the same for every seed.
            point: `ordering`, an index into `ORDERINGS`.
            trained: the encoder.

        Returns:
            Mean test errors [prefixes], and the errors of all test frames [prefixes, T].
        """
        arch, ordering = self.arch, point["ordering"]
        learned = jnp.arange(arch.latent)
        shuffled = jax.random.permutation(jax.random.fold_in(jax.random.key(0), ordering), arch.latent)
        order = jnp.where(ordering == 0, learned, shuffled)
        order = jnp.where(ordering == len(ORDERINGS) - 1, learned[::-1], order)
        mask = mode_mask(full_mode(arch.n_views), arch.n_views)
        lengths = jnp.array(self.prefixes, jnp.int32)
        judged = judge_prefixes(trained, arch, mask, lengths, order=order)
        return {"test_mean_m": jnp.mean(judged.test_error_m, axis=-1), "test_error_m": judged.test_error_m}
