"""Every number of the paper that a table of ours has a counterpart of, read from the tables of a results folder."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from ovibjax.cards.ablation_claims import PAPER_M as PAPER_ABLATION_M
from ovibjax.cards.ablation_drawing import NAMES as VARIANTS
from ovibjax.cards.congestion_drawing import PAPER_ALL_EDGE_MS, PAPER_TOP
from ovibjax.cards.control_drawing import NAMES as POLICIES
from ovibjax.cards.control_drawing import PAPER_MEAN_M, PAPER_P95_M
from ovibjax.cards.indoor_paper import PAPER as PAPER_INDOOR
from ovibjax.cards.retrieval_claims import PAPER as PAPER_RETRIEVAL
from ovibjax.cards.retrieval_claims import PAPER_M as PAPER_RETRIEVAL_M
from ovibjax.cards.scheduling_drawing import NAMES as RULES
from ovibjax.cards.scheduling_study import PAPER_TIES
from ovibjax.control.environment import PAPER_REQUESTS
from ovibjax.report.claims import Interval, interval
from ovibjax.report.comparison import Pair
from ovibjax.report.sections import read_table

PAPER_COMPRESSION_M = {16: 9.31, 35: 9.18, 128: 10.11}
PAPER_COMPRESSION_KB = {16: 0.082, 35: 0.156, 128: 0.520}
"""The paper's error and payload by prefix (Section "Scalable Compression Performance")."""

PAPER_FIXED_M, PAPER_FUSION_M = 9.06, 10.92
"""The paper's fixed-rate encoder of 16 floats and its fusion baseline."""

_QUEUE = {"edge_p95_ms": ("edge p95", "ms"), "e2e_p95_ms": ("end-to-end p95", "ms"), "cost": ("weighted cost", "")}
_QUEUE |= {"stale_m": ("stale feedback", "m")}
_INDOOR = (("kb", "payload", "KB"), ("mean_m", "mean", "m"), ("p90_m", "p90", "m"), ("recall_0.5m", "recall", ""))

Rows = Sequence[Mapping[str, str]]


@dataclass(frozen=True)
class Point:
    """One number of the paper, and the cells that are its counterpart.

    Attributes:
        file: table, below the results folder.
        where: cells that select the rows, by column.
        column: the metric.
        quantity: what it is, in words.
        unit: of the paper's number.
        paper: the paper's number.
        repetition: column of independent repetitions; rows that agree in it are averaged first.
        scale: what the cells are multiplied with.
    """

    file: str
    where: Mapping[str, str]
    column: str
    quantity: str
    unit: str
    paper: float
    repetition: str = "seed"
    scale: float = 1.0

    def pair(self, rows: Rows) -> Pair | None:
        """The paper's number beside ours; None where the table has none."""
        kept = [row for row in rows if all(row.get(name) == cell for name, cell in self.where.items())]
        kept = [row for row in kept if row.get(self.column)]
        if not kept:
            return None
        ours = _stated(kept[0], self.column)
        if ours is None:
            groups: dict[str, list[float]] = {}
            for row in kept:
                groups.setdefault(row.get(self.repetition, ""), []).append(float(row[self.column]))
            ours = interval([sum(group) / len(group) for group in groups.values()])
        # What does not differ from seed to seed has no interval.
        half = ours.half if ours.half > 1e-6 * abs(ours.mean) else float("inf")
        scaled = Interval(self.scale * ours.mean, self.scale * half)
        return Pair(self.file.partition("/")[0], self.quantity, self.unit, self.paper, scaled)


def paper_pairs(folder: Path) -> Iterator[Pair]:
    """The paper's numbers beside ours.

    Args:
        folder: results folder; what it lacks is left out.

    Yields:
        The pairs, in the paper's order.
    """

    @cache
    def rows(file: str) -> Rows:
        if not (folder / file).is_file():
            return []
        table = read_table(folder / file)
        return [dict(zip(table.header, row, strict=False)) for row in table.rows]

    for point in points():
        pair = point.pair(rows(point.file))
        if pair is not None:
            yield pair
    yield from _uploads(rows("view_rate_selection/table.csv"))


def points() -> Iterator[Point]:
    """All points that are cells of one table."""
    yield from _compression()
    yield from _retrieval()
    for metric, paper, word in (("mean_m", PAPER_MEAN_M, "mean"), ("p95_m", PAPER_P95_M, "p95")):
        for policy, number in paper.items():
            where, said = {"policy": policy}, f"{POLICIES[policy]}: {word} route error"
            yield Point("request_control/table.csv", where, metric, said, "m", number)
    yield Point("request_control/table.csv", {"policy": "voi"}, "requests", "VOI-Control: requests", "", PAPER_REQUESTS)
    high = {"congestion": "high", "ties": PAPER_TIES}
    for metric, by_rule in PAPER_TOP.items():
        for rule, number in by_rule.items():
            where, (word, unit) = high | {"policy": rule, "scope": "top10"}, _QUEUE[metric]
            said = f"{RULES[rule]}: {word}, most valuable tenth, high congestion"
            yield Point("multi_client/table.csv", where, metric, said, unit, number)
    for rule, number in PAPER_ALL_EDGE_MS.items():
        where, said = high | {"policy": rule, "scope": "all"}, f"{RULES[rule]}: edge p95, all requests, high congestion"
        yield Point("multi_client/table.csv", where, "edge_p95_ms", said, "ms", number)
    yield from _indoor()


def _compression() -> Iterator[Point]:
    file = "scalable_compression/table.csv"
    for k, error_m in PAPER_COMPRESSION_M.items():
        where = {"method": "ovib", "k": str(k)}
        yield Point(file, where, "mean_m", f"O-VIB: mean error at k = {k}", "m", error_m)
        said = f"O-VIB: payload at k = {k}"
        yield Point(file, where, "payload_bytes", said, "KB", PAPER_COMPRESSION_KB[k], scale=1 / 1024)
    for variant, error_m in PAPER_ABLATION_M.items():
        where = {"variant": "gamma_0.1" if variant == "full" else variant, "ordering": "learned", "k": "35"}
        said = f"{VARIANTS[variant]}: mean error at k = 35"
        yield Point("encoder_ablation/table.csv", where | {"alpha": "1"}, "test_mean_m", said, "m", error_m)
    file, best = "single_scene_ib/table.csv", {"method": "ovib_fixed", "beta": "0.001", "gamma": "0.1"}
    yield Point(file, best, "test_mean_m", "fixed-rate O-VIB of 16 floats: mean error", "m", PAPER_FIXED_M)
    where = {"method": "attention_fusion"}
    yield Point(file, where, "test_mean_m", "multi-view fusion baseline: mean error", "m", PAPER_FUSION_M)


def _retrieval() -> Iterator[Point]:
    file, where = "retrieval/table.csv", {"tile_m": "30", "scenes": "2", "tiles": "12"}
    for column, said in (("pruned", "share pruned"), ("scene_hit", "scene kept"), ("tile_hit", "tile kept")):
        paper = PAPER_RETRIEVAL[column.removesuffix("_hit")]
        yield Point(file, where, column, f"{said}, 2 scenes and 12 tiles", "", paper)
    for column, name, said in (
        ("brute_m", "brute", "brute force: error"),
        ("error_m", "fine", "coarse to fine: error"),
        ("error_hit_m", "hit", "coarse to fine: error where the tile is kept"),
    ):
        yield Point(file, where, column, said, "m", PAPER_RETRIEVAL_M[name])


def _indoor() -> Iterator[Point]:
    for platform, paper in PAPER_INDOOR.items():
        for k, numbers in paper.table.items():
            name = k if isinstance(k, str) else f"O-VIB-{k}"
            where = {"platform": platform, "representation": name}
            for (column, word, unit), number in zip(_INDOOR, numbers, strict=True):
                yield Point("real_scene/summary.csv", where, column, f"{platform}, {name}: {word}", unit, number)
        file = "real_scene/table.csv"
        said = f"{platform}: query to nearest reference"
        yield Point(file, {"platform": platform}, "floor_m", said, "m", paper.floor_m, "room")
        for mode, error_m in paper.mode_m.items():
            where = {"platform": platform, "method": "retrieval", "mode": mode}
            said = f"{platform}, retrieval with views {mode}: mean"
            yield Point(file, where, "mean_m", said, "m", error_m, "room")


def _uploads(rows: Rows) -> Iterator[Pair]:
    """Share of slots with an upload by context: the sum over view modes, whose intervals do not add up."""
    from ovibjax.control.environment import PAPER_UPLOAD_SHARE
    from ovibjax.features.frames import CONTEXTS

    for context, share in zip(CONTEXTS, PAPER_UPLOAD_SHARE, strict=True):
        percent = [float(row["upload_percent"]) for row in rows if row.get("context") == context]
        if percent:
            ours = Interval(sum(percent), float("inf"))
            yield Pair("view_rate_selection", f"slots with an upload: {context}", "%", 100 * share, ours)


def _stated(row: Mapping[str, str], column: str) -> Interval | None:
    """A cell with its interval, `0.336 ± 0.021` or in a column beside it; None where rows are repetitions."""
    mean, sign, half = row[column].partition("±")
    if sign:
        return Interval(float(mean), float(half))
    if f"{column}_half" in row:
        return Interval(float(mean), float(row[f"{column}_half"]))
    return None
