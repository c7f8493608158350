"""Fig. "Scalable O-VIB compression" and Table "Deployment overhead": one nested encoder against its rivals."""

import time

import numpy as np

from ovibjax.cards.codec_claims import codec_claims
from ovibjax.cards.codec_frontier import RIVAL_K, Frontier
from ovibjax.cards.codec_study import code_and_judge
from ovibjax.cards.compression_claims import compression_claims
from ovibjax.cards.compression_drawing import draw
from ovibjax.cards.compression_methods import TRAINED, run_methods, train_config
from ovibjax.cards.compression_results import Results, collect, table_rows
from ovibjax.cards.deployment_overhead import LINK_KB_PER_S, measure_encoder, overhead_rows
from ovibjax.cards.job import CardInterrupted, Job
from ovibjax.encoder.training_data import member_data
from ovibjax.report import figures as fig
from ovibjax.report.claims import write_claims
from ovibjax.report.rows import write_rows
from ovibjax.runtime.precision_choice import faster_precision

TITLE = "Scalable O-VIB compression"
METHODS = {"smoke": TRAINED, "quick": ("ovib", "pca_completed"), "full": TRAINED}
SEEDS = {"smoke": 2, "quick": 3, "full": 5}
STEPS = {"smoke": 60, "quick": None, "full": None}
"""Training steps of every method; None: by the number of frames (`encoder.recipe`)."""


def run(job: Job) -> None:
    """Run the card: train, judge, code images, write tables, claims and figure; Ctrl-C keeps the finished seeds."""
    started = time.perf_counter()
    steps, precision = STEPS[job.preset], faster_precision()
    seeds = range(job.seed, job.seed + SEEDS[job.preset])
    with job.stage("features"):
        prepared = {seed: member_data(job.features, seed, job.rank) for seed in seeds}
    with job.stage("train"):
        outcomes, interrupted = run_methods(prepared, METHODS[job.preset], steps, precision)
    frontier, codec_note = None, " Image codecs are left out: the run was interrupted."
    if not interrupted:
        try:
            frontier, codec_note = code_and_judge(job, prepared, outcomes)
        except KeyboardInterrupt:
            interrupted = True
    member, basis = prepared[next(iter(outcomes))]
    results = collect(outcomes, raw_floats=int(np.prod(job.features.features.shape[1:])))
    write_rows(job.out / "table.csv", table_rows(results))
    basis_bytes = 4 * (basis.axes.size + basis.mean.size)
    with job.stage("time"):
        encoder = measure_encoder(results, member)
    write_rows(job.out / "overhead.csv", overhead_rows(results, member, encoder, basis_bytes))
    _write_codecs(job, frontier)
    claims = [*compression_claims(results, job.embedded), *(codec_claims(frontier, LINK_KB_PER_S) if frontier else [])]
    write_claims(job.out / "claims.json", claims)
    with job.stage("draw"):
        draw(job.out / "figure.png", results, frontier)
    view_dim, kept = member.train.x.shape[2], float(np.mean([b.energy_kept.mean() for _, b in prepared.values()]))
    losses = {method: outcome.losses for method, outcome in next(iter(outcomes.values())).items()}
    job.record(
        *(TITLE, caption(results, kept, view_dim) + codec_note, outcomes, started),
        preset=job.preset + (" (interrupted)" if interrupted else ""),
        selected_k=results.chosen,
        view_coordinates=view_dim,
        energy_kept=round(kept, 4),
        precision=precision,
        steps=train_config("ovib", member, steps, precision).steps_on(len(member.train.x)),
        final_losses={method: {name: float(v[-1]) for name, v in terms.items()} for method, terms in losses.items()},
    )
    if interrupted:
        raise CardInterrupted(
            f"interrupted; {job.out} holds the figure of the finished seeds {' '.join(map(str, outcomes))}"
        )


def _write_codecs(job: Job, frontier: Frontier | None) -> None:
    path = job.out / "codec.csv"
    path.unlink(missing_ok=True)  # of an earlier run on data with images
    if frontier:
        write_rows(path, frontier.table_rows())


def caption(results: Results, energy_kept: float, view_dim: int) -> str:
    """What the reader of the figure needs to know."""
    return (
        f"(a) One trained model at every prefix k; selected on validation: k = {results.chosen}. (b) Serialized "
        "payload against error; dashed: the references have passed through the same code. (c) Errors per test frame of "
        "all seeds; box: quartiles, whiskers: 5th and 95th percentile, diamond: mean, red tick: 90th percentile. (d) "
        f"Encoding after feature extraction (Jetson Orin NX profile) plus transmission at {LINK_KB_PER_S} KB/s; image "
        "codecs: encoding of the five views measured here, plus transmission, where they reach O-VIB's error "
        f"at k = {RIVAL_K}; black ticks: paper. {fig.spread(len(results.outcomes))} (split, initialisation, "
        "minibatches). The database holds uncompressed reference descriptors (frozen localizer) unless said. "
        f"{view_dim} principal coordinates per view keep {100 * energy_kept:.0f} % of the feature variance."
    )
