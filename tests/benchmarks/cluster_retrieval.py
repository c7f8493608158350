"""Retrieval among clusters of like descriptors against FAISS: exhaustive, and its inverted lists at their best.

    python tests/benchmarks/cluster_retrieval.py
    python tests/benchmarks/cluster_retrieval.py --sizes 1000000 --at 1000000

Needs the `bench` extra. Databases, queries and descriptors are those of `retrieval.py`. FAISS builds inverted lists of
each number that is asked for (`--lists`, in square roots of N), each is searched with the fewest probes that reach the
recall on tuning queries, and the quickest of them is the peer; ours keeps the fewest blocks that do. Times are those of
other queries, in one batch and one by one from Python, by turns, the best of the repetitions. The last line is the
ratio to `IndexIVFFlat` in one batch.

2 virtual cores (AMD EPYC with AVX-512), quiet, Python 3.11, jax 0.10.2, faiss 1.15.1; microseconds a query in a batch
of 400, and asked alone:

    N = 5,000      IndexFlatIP   22.2   109   best lists    4.6    16   clusters   13.4   132   recall 98.2 / 98.0 %
    N = 100,000    IndexFlatIP    508  9452   best lists   35.1    79   clusters   35.5   180   recall 98.5 / 99.0 %
    N = 1,000,000  IndexFlatIP   4504 91913   best lists    180   328   clusters   97.4   331   recall 98.8 / 99.2 %
    ratio: 0.99 at 100,000, 1.85 at 1,000,000

Built in 2.4 and 27 s (lists in 5.7 and 69 s), 233 and 2,291 MB (208 and 2,064). On a busy machine it came to 1.6 to 1.9
at 100,000, as FAISS's threads wait for each other. One query at 5,000 is below 0.2 ms, and slower than FAISS's.
"""

import argparse
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

CORES = os.cpu_count() or 1
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import faiss
import jax
import numpy as np

from ovibjax.cards.synthetic_database import Database, recombine
from ovibjax.edge import cluster_index, nearest
from tests.benchmarks.retrieval import contributions, drives, smallest

PROBES = (1, 2, 3, 4, 6, 8, 12, 16, 20, 24, 32, 40, 48, 64, 80, 96, 128, 192, 256, 384, 512)
SINGLY = 100
"""Queries that are asked one by one."""

Search = Callable[[np.ndarray], np.ndarray]


class Contender(NamedTuple):
    """What is compared.

    Attributes:
        search: rows for queries.
        build_s: seconds that its index took.
        size_bytes: its index, descriptors included.
        note: what it was set to.
    """

    search: Search
    build_s: float
    size_bytes: int
    note: str


def flat_of(data: Database) -> Contender:
    """The exhaustive search of FAISS."""
    start = time.perf_counter()
    flat = faiss.IndexFlatIP(data.reference.shape[1])
    flat.add(data.reference)
    took_s = time.perf_counter() - start
    return Contender(lambda q: flat.search(q, 1)[1][:, 0], took_s, data.reference.nbytes, "")


def lists_of(data: Database, count: int, recall: Callable[[Search], float], goal: float) -> Contender:
    """The inverted lists of FAISS, with as few probes as the recall allows."""
    n, dim = data.reference.shape
    start = time.perf_counter()
    coarse = faiss.IndexFlatIP(dim)
    lists = faiss.IndexIVFFlat(coarse, dim, count, faiss.METRIC_INNER_PRODUCT)
    lists.cp.max_points_per_centroid = 64
    lists.train(data.reference)
    lists.add(data.reference)
    took_s = time.perf_counter() - start

    def search(query: np.ndarray, probes: int) -> np.ndarray:
        lists.nprobe = probes
        return lists.search(query, 1)[1][:, 0]

    probes = smallest(PROBES, lambda p: recall(lambda q: search(q, p)), goal)
    size_bytes = data.reference.nbytes + 8 * n + 4 * dim * count
    note = f"{probes} of {count} lists"
    return Contender(lambda q: search(q, probes), took_s, size_bytes, note)


def ours_of(data: Database, engine: str, recall: Callable[[Search], float], goal: float) -> Contender:
    """Our clusters, with as few probes as the recall allows."""
    start = time.perf_counter()
    index: Any = cluster_index(data.reference, engine=engine)
    took_s = time.perf_counter() - start

    def search(query: np.ndarray, probes: int) -> np.ndarray:
        return np.asarray(nearest(query, index, probes=probes).row)[:, 0]

    probes = smallest(PROBES, lambda p: recall(lambda q: search(q, p)), goal)
    blocks, dim = index.prototype.shape
    if engine == "ovibjax":
        size_bytes = sum(leaf.nbytes for leaf in index)
    else:
        size_bytes = data.reference.nbytes + 8 * len(data.reference) + 4 * dim * blocks
    return Contender(lambda q: search(q, probes), took_s, size_bytes, f"{probes} of {blocks} blocks")


def seconds(contenders: dict[str, Contender], query: np.ndarray, repeats: int) -> dict[str, float]:
    """Best seconds of each for the queries in one batch, by turns."""
    best = dict.fromkeys(contenders, float("inf"))
    for _ in range(repeats):
        for name, contender in contenders.items():
            start = time.perf_counter()
            contender.search(query)
            best[name] = min(best[name], time.perf_counter() - start)
    return best


def singly(contenders: dict[str, Contender], query: np.ndarray, repeats: int) -> dict[str, float]:
    """Median seconds of one query, asked alone, in the best of the repetitions."""
    best = dict.fromkeys(contenders, float("inf"))
    for _ in range(repeats):
        for name, contender in contenders.items():
            took = []
            for q in range(min(SINGLY, len(query))):
                start = time.perf_counter()
                contender.search(query[q : q + 1])
                took.append(time.perf_counter() - start)
            best[name] = min(best[name], float(np.median(took)))
    return best


def compare(data: Database, goal: float, repeats: int, multiples: list[float], with_faiss: bool) -> dict[str, float]:
    """Best seconds of each contender in one batch; prints a line for each."""
    n = len(data.reference)
    contenders = {"IndexFlatIP": flat_of(data)}
    truth = contenders["IndexFlatIP"].search(data.query)
    half = np.arange(len(truth)) % 2 == 0
    tune, timed = data.query[half], np.ascontiguousarray(data.query[~half])

    def recall(search: Search) -> float:
        return float(np.mean(search(tune) == truth[half]))

    for multiple in multiples:
        count = round(multiple * n**0.5)
        contenders[f"IndexIVFFlat {count}"] = lists_of(data, count, recall, goal)
    contenders["clusters"] = ours_of(data, "ovibjax", recall, goal)
    if with_faiss:
        contenders["clusters in faiss"] = ours_of(data, "faiss", recall, goal)
    print(f"\nN = {n:,}: {len(timed)} queries", flush=True)
    found = {name: np.mean(contender.search(timed) == truth[~half]) for name, contender in contenders.items()}
    batch, one = seconds(contenders, timed, repeats), singly(contenders, timed, max(2, repeats // 2))
    for name, contender in contenders.items():
        print(
            f"  {name:20s} {1e6 * batch[name] / len(timed):8.1f} us/query in a batch  {1e6 * one[name]:8.1f} us alone  "
            f"recall@1 {found[name]:6.1%}  built in {contender.build_s:6.1f} s  {contender.size_bytes / 1e6:7.0f} MB  "
            f"{contender.note}",
            flush=True,
        )
    peer = min(batch[name] for name in batch if name.startswith("IndexIVFFlat"))
    flat = batch["IndexFlatIP"] / batch["clusters"]
    print(f"  clusters: {peer / batch['clusters']:.2f} x IndexIVFFlat, {flat:.2f} x IndexFlatIP", flush=True)
    return {"ratio": peer / batch["clusters"], "flat": flat}


def main() -> None:
    """Compare at each size and print the ratio at the one asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[5_000, 100_000, 1_000_000], help="descriptors")
    parser.add_argument("--queries", type=int, default=400, help="timed queries (default 400)")
    parser.add_argument("--dim", type=int, default=512, help="descriptor dimension (default 512)")
    parser.add_argument("--recall", type=float, default=0.98, help="recall@1 wanted (default 0.98)")
    parser.add_argument("--repeats", type=int, default=7, help="repetitions, the best counts (default 7)")
    parser.add_argument("--lists", type=float, nargs="+", default=[2, 4, 8], help="lists of FAISS over sqrt(N)")
    parser.add_argument("--at", type=int, default=100_000, help="size of the last line's ratio (default 100000)")
    parser.add_argument("--engine", action="store_true", help="our clusters in FAISS as well (another copy)")
    options = parser.parse_args()
    faiss.omp_set_num_threads(CORES)
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    print(f"{CORES} cores, load {load:.1f}, jax {jax.__version__}, faiss {faiss.__version__}", flush=True)
    sets = drives()
    views: Any = contributions(sets, options.dim)
    places = [s.positions_m[:, :2] for s in sets]
    ratios = {}
    for n in options.sizes:
        data = recombine(0, views, places, n, 2 * options.queries)
        for rows in (data.reference, data.query):
            rows /= np.linalg.norm(rows, axis=1, keepdims=True)
        ratios[n] = compare(data, options.recall, options.repeats, options.lists, options.engine)["ratio"]
        del data  # two gigabytes at a million
    if options.at in ratios:
        print(f"ratio: {ratios[options.at]:.2f}")


if __name__ == "__main__":
    main()
