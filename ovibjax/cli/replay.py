"""The command `ovibjax replay`: one route under one or several request policies."""

import difflib
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from ovibjax.cli.options import own_drive
from ovibjax.errors import InputError
from ovibjax.runtime.progress import console, progress_bar, width_of

if TYPE_CHECKING:
    from ovibjax.control.actions import ActionSet
    from ovibjax.control.controller import Controller
    from ovibjax.control.route_replay import RouteResult
    from ovibjax.control.scene import Scene
    from ovibjax.link.traces import Trace


@dataclass(frozen=True)
class Replay:
    """Replay a held-out route slot by slot under a request policy, and print what came of it.

    A client dead-reckons along the route and asks the edge for corrections. The default is the embedded town and
    VOI-Control with the prices that the tuning seeds selected; voi_gap has prices of its own.

    Example: ovibjax replay --policy voi uncertainty --profile 8 --seed 103 --plot
    """

    policy: tuple[str, ...] = ("voi",)
    """voi, voi_gap, periodic, budgeted_periodic, fixed_front, random, uncertainty, oracle_action; several are compared
    on the same drift, channel and queue."""
    profile: float = 8.0
    """Mean uplink throughput in KB/s, with block fading around it; the paper's profiles are 4, 8 and 12."""
    seed: int = 100
    """One realization of drift, channel, queue and timing. Seeds below 100 are for tuning."""
    route: int = 0
    """Which held-out route."""
    trace: Path | None = None
    """A measured throughput trace instead of the profile: two columns `seconds Mbit/s` (Pensieve), a table with named
    columns (CSV, drive tests), bare rates per second, Mahimahi, the 4G and HSDPA logs, or JSON of iperf3."""
    max_gap: float | None = None
    """Longest interval between samples of the trace, s; by default 10, or 5 times the usual interval. In a gap that
    only this allows the link is dead."""
    trace_unit: str | None = None
    """Unit of the trace's rates where its file does not say it: bit, kbit, Mbit, Gbit, byte, kB, KB, MB."""
    trace_column: tuple[str, ...] = ()
    """Which columns of the trace are meant: DL_bitrate, or with what they hold, time_ms=t kbps=down; columns without
    names are 1, 2, ..."""
    data: Path | None = None
    """Your own frames, in order and half a second apart (.npz or folder, see `ovibjax reproduce --help`): the first
    60 % are the training route, the rest is replayed."""
    order: Literal["drive", "places"] | None = None
    """Whether the frames of --data are a drive in their order, or places in no order; by default as they look."""
    budget: float = 2.1
    """Payload allowed over the route, KB."""
    drift: float = 1.0
    """Factor on the drift rates of the odometry."""
    drift_model: str = "rate"
    """How the error grows between corrections: rate (linearly), integrated (faster), random_walk."""
    correction: str = "replace"
    """What the edge's position does: replace (it becomes the estimate where the risk that comes with it is the lower
    one), always (it becomes the estimate) or kalman (it is fused with the estimate)."""
    gate: float | None = None
    """Discard corrections that lie further off than so many standard deviations of what the client expects; 3 is
    usual, the paper has no such gate."""
    lambda_b: float | None = None
    """Price of a second of transmission, m/s."""
    lambda_d: float | None = None
    """Price of a second of queueing, service and return, m/s."""
    threshold: float | None = None
    """Net VOI above which the variant voi_gap asks, m."""
    gap: float | None = None
    """Shortest time between two requests of voi_gap, s."""
    plot: bool = False
    """Draw the timeline of the first policy."""
    out: Path = Path("replay.png")
    """File of the timeline."""

    def run(self) -> None:
        """Run the command."""
        self._check()
        import jax

        from ovibjax.cards.control_study import PRESETS, drives_of
        from ovibjax.control.client_state import ControlParams
        from ovibjax.control.environment import SLOT_S, draw, make_environment
        from ovibjax.control.route_replay import replay_draws
        from ovibjax.control.route_summary import summarize
        from ovibjax.control.scene import make_scene
        from ovibjax.link.traces import resample

        measured = self._measured()
        own = own_drive(self.data, self.order)
        with progress_bar("rendering the routes", 1) as update:
            drives, training = drives_of("full", own, update)
        with console.status("training the checkpoint, retrieving residuals"):
            scene = make_scene(drives, training, PRESETS["full"].checkpoint)
        if self.route >= len(scene.held_out):
            raise InputError(f"--route {self.route}: there are held-out routes 0 to {len(scene.held_out) - 1}")
        route = jax.tree.map(jax.numpy.asarray, scene.held_out[self.route])
        env = make_environment(scene.context_share, self.profile, self.drift, self.drift_model)
        params = {name: ControlParams(env, self._controller(name, scene.actions)) for name in self.policy}
        draws = draw(jax.random.key(self.seed), route, env, scene.actions)
        if measured is not None:
            rate = resample(measured, SLOT_S, len(scene.held_out[self.route].context))
            draws = draws._replace(rate_bps=jax.numpy.asarray(rate))
        with console.status("replaying"):
            runs = {
                name: jax.device_get(replay_draws(draws, route, name, params[name], scene.actions))
                for name in self.policy
            }
        summaries = {name: summarize(run) for name, run in runs.items()}
        self._print({name: [float(value) for value in summary] for name, summary in summaries.items()})
        if self.plot:
            self._draw(runs[self.policy[0]], scene)

    def _measured(self) -> "Trace | None":
        """The measured trace, if one is given; says what was understood."""
        from ovibjax.link.trace_files import read_trace

        if self.trace is None:
            for name in ("max_gap", "trace_unit", "trace_column"):
                if getattr(self, name) not in (None, ()):
                    raise InputError(f"--{name.replace('_', '-')} belongs to --trace FILE")
            return None
        trace = read_trace(self.trace, self.max_gap, self.trace_unit, self.trace_column)
        console.print(f"trace: {trace.source}: {trace.describe()}", markup=False, highlight=False, soft_wrap=True)
        return trace

    def _check(self) -> None:
        """Refuse what cannot be replayed before anything is rendered."""
        from ovibjax.control.belief import CORRECTIONS
        from ovibjax.control.drift import DRIFT_MODELS
        from ovibjax.control.policies import POLICIES

        if not self.policy:
            raise InputError(f"--policy: name at least one of {', '.join(POLICIES)}")
        words: list[tuple[str, str, Sequence[str]]] = [("policy", name, tuple(POLICIES)) for name in self.policy]
        words += [("drift-model", self.drift_model, tuple(DRIFT_MODELS)), ("correction", self.correction, CORRECTIONS)]
        for option, word, known in words:
            if word not in known:
                near = difflib.get_close_matches(word, known, n=1)
                hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(known)}"
                raise InputError(f"--{option} {word}: no such {option.replace('-', ' ')}; {hint}")
        for name in ("seed", "route", "budget", "drift", "lambda_b", "lambda_d", "threshold", "gap", "gate"):
            value = getattr(self, name)
            if value is not None and not 0 <= value < float("inf"):
                raise InputError(f"--{name.replace('_', '-')} {value} is not a number of zero or more")
        if not 0 < self.profile < float("inf"):
            raise InputError(f"--profile {self.profile} is not a positive number of KB/s")
        if self.plot and not self.out.parent.is_dir():
            raise InputError(f"--out {self.out}: the folder does not exist")
        if self.plot and (self.out.is_dir() or not self.out.suffix):
            raise InputError(f"--out {self.out}: give the name of a file, such as replay.png")

    def _controller(self, policy: str, actions: "ActionSet") -> "Controller":
        """What a policy replays with: what the user gave, else what the tuning seeds selected for it."""
        from ovibjax.control.controller import GAP_LAMBDA_B_M_PER_S, GAP_LAMBDA_D_M_PER_S, make_controller

        given = {"bandwidth_m_per_s": self.lambda_b, "delay_m_per_s": self.lambda_d}
        given |= {"threshold_m": self.threshold, "min_gap_s": self.gap, "gate_sigma": self.gate}
        numbers = {name: value for name, value in given.items() if value is not None}
        if policy == "voi_gap":
            numbers = {"bandwidth_m_per_s": GAP_LAMBDA_B_M_PER_S, "delay_m_per_s": GAP_LAMBDA_D_M_PER_S} | numbers
        return make_controller(actions, budget_kb=self.budget, correction=self.correction, **numbers)

    def _print(self, rows: dict[str, list[float]]) -> None:
        from rich.console import Console
        from rich.table import Table

        table = Table()
        columns = ("policy", "mean error (m)", "p95 error (m)", "mean risk (m)", "requests", "payload (KB)")
        for column in columns:
            # The longest policy in full on 80 columns too.
            table.add_column(column, justify="left" if column == "policy" else "right", no_wrap=column == "policy")
        for name, (mean, p95, risk, requests, kb) in rows.items():
            table.add_row(name, f"{mean:.2f}", f"{p95:.2f}", f"{risk:.2f}", f"{requests:.0f}", f"{kb:.2f}")
        Console(width=width_of(sys.stdout)).print(table)

    def _draw(self, run: "RouteResult", scene: "Scene") -> None:
        from ovibjax.cards.timeline import draw_timeline

        context = scene.held_out[self.route].context
        try:
            draw_timeline(self.out, run, context, scene.contexts, scene.actions, self.policy[0])
        except OSError as error:
            raise InputError(f"{self.out}: cannot write there ({error.strerror}); choose another --out") from error
        console.print(f"timeline: {self.out}")
