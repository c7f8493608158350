"""Which tables of the results a reader may explore, and how: axes, metrics, what is drawn first."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ovibjax.cards.ablation_drawing import NAMES as VARIANTS
from ovibjax.cards.adaptation_drawing import LABELS as ARM_NAMES
from ovibjax.cards.compression_drawing import NAMES as METHODS
from ovibjax.cards.control_drawing import MODEL_NAMES
from ovibjax.cards.control_drawing import NAMES as POLICIES
from ovibjax.cards.scheduling_drawing import NAMES as RULES
from ovibjax.cards.scheduling_study import PAPER_TIES
from ovibjax.control.predictor import PRIORS
from ovibjax.errors import InputError
from ovibjax.features.images.codecs import NAMES as CODECS
from ovibjax.report.sections import read_table
from ovibjax.report.web.studies import Study, TableStudy

_ERROR = {"mean_m": "mean error (m)", "p90_m": "90th percentile (m)"}
_TEST = {"test_mean_m": "test mean error (m)", "test_p90_m": "test 90th percentile (m)"}
_TEST |= {"val_mean_m": "validation mean error (m)", "eta": "mixing weight η"}
_ROUTE = {"mean_m": "route error, mean (m)", "p95_m": "route error, p95 (m)", "requests": "requests", "kb": "sent (KB)"}
_QUEUE = {"edge_p95_ms": "edge p95 (ms)", "e2e_p95_ms": "end-to-end p95 (ms)", "stale_m": "stale feedback (m)"}
_QUEUE |= {"cost": "weighted cost", "edge_cost": "weighted cost at the edge"}
_LIVE = {"live_p95_ms": "edge p95, live (ms)", "planned_p95_ms": "edge p95, replayed before the run (ms)"}
_LIVE |= {"service_p95_ms": "edge p95, replayed with its service times (ms)"}
_LIVE |= {"kept_p95_ms": "edge p95, replayed with service and dispatch (ms)"}
_LIVE |= {"live_e2e_p95_ms": "end-to-end p95, live (ms)", "share_busy": "share of time busy"}
_SYSTEM = {"mean_route_m": "route error, mean (m)", "p95_route_m": "route error, p95 (m)", "kb": "sent (KB)"}
_SYSTEM |= {"top_edge_p95_ms": "edge p95, top decile (ms)", "top_cost": "weighted cost, top decile"}
_SYSTEM |= {"all_edge_p95_ms": "edge p95, all requests (ms)"}
_FOUND = {"pruned": "share pruned", "scene_hit": "scene kept", "tile_hit": "tile kept", "error_m": "error (m)"}
_FOUND |= {"error_hit_m": "error where the tile is kept (m)", "wrong_scene": "wrong scene", "same": "same answer"}
_AXES = {"k": "prefix k", "policy": "policy", "beta": "β", "gamma": "γ", "tile_m": "tile (m)", "scope": "requests"}
_AXES |= {"top10": "most valuable tenth", "all": "all requests", "time_s": "time (s)", "slots": "slots"}
_METHODS = METHODS | {
    "ovib_fixed": "fixed-rate O-VIB",
    "attention_fusion": "attention fusion",
    "retrieval": "retrieval",
}
_METHODS |= {"ovib_recoded": "O-VIB, references coded too", "pca_recoded": "PCA, references coded too"}

TABLES: dict[str, TableStudy] = {
    "scalable_compression/table.csv": TableStudy(
        "prefixes",
        "Compression: every prefix and method",
        ("method", "k"),
        _ERROR | {"payload_bytes": "payload (bytes)", "eta": "mixing weight η"},
        start={
            "x": "k",
            "lines": "method",
            "show": [METHODS[name] for name in ("ovib", "vib", "pca", "pca_completed")],
        },
        labels=_AXES | _METHODS,
    ),
    "scalable_compression/codec.csv": TableStudy(
        "codecs",
        "Compression: image codecs by quality",
        ("codec", "quality"),
        {"payload_bytes": "payload (bytes)", "mean_m": "mean error (m)", "encode_ms": "time to encode (ms)"},
        start={"x": "quality", "lines": "codec"},
        labels=CODECS,
    ),
    "encoder_ablation/table.csv": TableStudy(
        "ablation",
        "Ablation: every prefix, variant and order",
        ("variant", "ordering", "k"),
        _TEST,
        start={
            "x": "k",
            "lines": "variant",
            "fixed": {"ordering": "learned"},
            "show": ["Full", *(VARIANTS[name] for name in ("no_rate", "no_orthogonality", "no_nesting", "pca"))],
        },
        labels=_AXES
        | VARIANTS
        | {"gamma_0.1": "Full", "tail_first": "tail first"}
        | {f"gamma_{gamma}": f"γ = {gamma}" for gamma in ("0.01", "1", "10")},
    ),
    "single_scene_ib/table.csv": TableStudy(
        "fixed",
        "Fixed rate: ARD weight and orthogonality",
        ("method", "beta", "gamma"),
        _TEST | {"active_dims": "active dimensions"},
        start={"x": "beta", "lines": "gamma", "fixed": {"method": "fixed-rate O-VIB"}},
        labels=_AXES | _METHODS,
    ),
    "retrieval/table.csv": TableStudy(
        "retrieval",
        "Retrieval: scenes, tiles and their size",
        ("tile_m", "scenes", "tiles"),
        _FOUND,
        half="_half",
        start={"metric": "tile_hit", "x": "tiles", "lines": "scenes"},
        labels=_AXES,
    ),
    "request_control/table.csv": TableStudy(
        "policies",
        "Request control: every policy",
        ("policy",),
        _ROUTE,
        start={"x": "policy"},
        labels=_AXES | POLICIES,
    ),
    "voi_predictor/sensitivity.csv": TableStudy(
        "sensitivity",
        "Request control: drift, budget, protocol and gate",
        ("policy", "model", "drift_scale", "budget_kb", "protocol", "correction", "gate_sigma"),
        {"mean_m": "route error, mean (m)"},
        repetition="",
        start={
            "x": "drift_scale",
            "lines": "policy",
            "fixed": {"model": "rate", "budget_kb": "2.1", "protocol": "paper", "correction": "replace"}
            | {"recode": "False", "prior": PRIORS[0]},
            "show": [POLICIES[name] for name in ("voi", "uncertainty", "budgeted_periodic", "random", "oracle_action")],
        },
        labels={"budget_kb": "budget (KB)", "drift_scale": "drift scale", "gate_sigma": "gate (σ)", "inf": "none"}
        | {"tuned_uncertainty": "Uncertainty, tuned"}
        | {"recode": "references coded too", "prior": "expected residual"}
        | POLICIES
        | MODEL_NAMES,
        optional=("recode", "prior"),
    ),
    "request_control/calibration.csv": TableStudy(
        "calibration",
        "Request control: claimed and realised risk",
        ("routes", "action"),
        {"claimed_rms_m": "claimed risk, rms (m)", "realised_rms_m": "error, rms (m)"}
        | {"median_claimed_m": "claimed risk, median (m)", "median_m": "error, median (m)"},
        repetition="",
        start={"x": "action", "lines": "routes"},
    ),
    "view_rate_selection/table.csv": TableStudy(
        "views",
        "Request control: uploads by context and views",
        ("context", "mode"),
        {"upload_percent": "slots with an upload (%)", "prior_compact_m": "expected residual (m)"},
        repetition="",
        start={"x": "context", "lines": "mode"},
    ),
    "voi_timing/table.csv": TableStudy(
        "route",
        "Request control: one route over time",
        ("time_s",),
        {"risk_before_m": "risk before (m)", "risk_m": "risk after (m)", "error_m": "error (m)"}
        | {"rate_bps": "uplink (bit/s)", "edge_delay_ms": "edge delay (ms)"},
        repetition="",
        start={"x": "time_s", "metric": "error_m"},
        labels=_AXES,
    ),
    "multi_client/table.csv": TableStudy(
        "congestion",
        "Scheduling: every rule, congestion and tie",
        ("policy", "congestion", "ties", "scope"),
        _QUEUE,
        start={
            "x": "congestion",
            "lines": "policy",
            "fixed": {"ties": PAPER_TIES, "scope": "most valuable tenth"},
        },
        labels=_AXES | RULES | {"policy": "rule"},
    ),
    "live/table.csv": TableStudy(
        "live",
        "Live edges beside their replay: every rule and load",
        ("policy", "load", "scope"),
        _LIVE,
        start={"x": "policy", "lines": "load", "fixed": {"scope": "most valuable tenth"}},
        labels=_AXES | RULES | {"policy": "rule"},
    ),
    "weights/table.csv": TableStudy(
        "weights",
        "Scheduling: the paper's weights and searched ones",
        ("setting", "scope"),
        _QUEUE,
        start={"x": "setting", "lines": "scope"},
        labels=_AXES | {"tuned_top10": "searched for the tenth", "tuned_all": "searched for all"},
    ),
    "theorem/table.csv": TableStudy(
        "theorem",
        "Scheduler theorem: utility and backlog by V",
        ("reading", "load", "V"),
        {"gap_m": "gap to the best (m)", "gap_bound_m": "its bound (m)", "backlog": "backlog"}
        | {"backlog_bound": "its bound", "utility_m": "utility (m)"},
        start={"x": "V", "lines": "reading"},
    ),
    "real_scene/table.csv": TableStudy(
        "rooms",
        "Rooms: platform, views and prefix",
        ("platform", "method", "mode", "k"),
        _ERROR | {"recall_0.5m": "recall within 0.5 m", "payload_bytes": "payload (bytes)"},
        repetition="room",
        start={"x": "k", "lines": "mode", "fixed": {"platform": "UAV", "method": "O-VIB"}},
        labels=_AXES | _METHODS,
    ),
    "system_grid/table.csv": TableStudy(
        "system",
        "The whole system: β, γ, k, V and rule",
        ("beta", "gamma", "k", "V", "scheduler"),
        _SYSTEM,
        half="_ci",
        start={
            "metric": "top_edge_p95_ms",
            "x": "k",
            "lines": "scheduler",
            "fixed": {"V": "8", "beta": "0.001", "gamma": "0.1"},
        },
        labels=_AXES | RULES | {"scheduler": "rule"},
    ),
    "bytes/table.csv": TableStudy(
        "bytes",
        "Real bytes: every method, code and prefix",
        ("method", "code", "setting", "step", "k"),
        {"mean_m": "mean error (m)", "code_bytes": "code (bytes)", "ideal_bytes": "ideal length (bytes)"}
        | {"packet_bytes": "packet (bytes)", "compact_bytes": "compact packet (bytes)"},
        start={
            "x": "k",
            "lines": "code",
            "fixed": {"method": METHODS["ovib"], "setting": "0.001", "step": "0"},
        },
        labels=_AXES | _METHODS | {"bits": "trained for bits", "pq": "product quantisation", "setting": "β or λ"},
    ),
    "bytes/system.csv": TableStudy(
        "coded_system",
        "Real bytes: routes and edge by code",
        ("code", "k"),
        {"mean_route_m": "route error, mean (m)", "requests": "requests", "kb": "sent (KB)"}
        | {"residual_m": "error of answers (m)", "edge_p95_ms_fifo": "edge p95, FIFO, top decile (ms)"}
        | {"edge_p95_ms_voi_lyapunov": "edge p95, VOI-Lyapunov, top decile (ms)"},
        start={"x": "k", "lines": "code"},
        labels=_AXES,
    ),
    "adaptation/table.csv": TableStudy(
        "adaptation",
        "Adaptation: worlds that change, and what robots expect",
        ("prior", "world", "arm"),
        {"mean_m": "route error, mean (m)", "after_m": "route error from the change on (m)"}
        | {"kb": "sent (KB)", "requests": "requests"},
        start={"x": "world", "lines": "arm", "fixed": {"prior": PRIORS[1]}},
        labels=_AXES | ARM_NAMES,
    ),
}
"""How each table is explored, by its file."""


def result_studies(folder: Path) -> Iterator[Study]:
    """The studies of a results folder; tables that are not there, or of another form, are left out.

    Args:
        folder: results folder.

    Yields:
        The studies, in the paper's order.
    """
    for name, spec in TABLES.items():
        if not (folder / name).is_file():
            continue
        table = read_table(folder / name)
        rows = [dict(zip(table.header, row, strict=False)) for row in table.rows]
        if name.endswith("sensitivity.csv"):
            rows = melted(rows, "_mean_m", "policy", "mean_m")
        try:
            yield spec.study(rows)
        except InputError:
            continue


def melted(rows: Sequence[Mapping[str, str]], suffix: str, into: str, value: str) -> list[dict[str, Any]]:
    """A table with a row per column of a kind: `voi_mean_m` becomes a row with policy `voi` and its `mean_m`.

    Args:
        rows: the table.
        suffix: what the names of these columns end in.
        into: column that takes what stands before the suffix.
        value: column that takes the cell.

    Returns:
        The longer table; other columns are repeated.
    """
    return [
        {into: name.removesuffix(suffix), value: cell}
        | {other: kept for other, kept in row.items() if not other.endswith(suffix)}
        for row in rows
        for name, cell in row.items()
        if name.endswith(suffix)
    ]
