"""Fig. "Coarse-to-fine retrieval on the sampled multi-scene benchmark": what prototypes prune, and what that costs."""

import time

from ovibjax.cards.job import Job
from ovibjax.cards.retrieval_benchmark import FRAMES, QUERIES
from ovibjax.cards.retrieval_claims import retrieval_caption, retrieval_claims
from ovibjax.cards.retrieval_drawing import draw
from ovibjax.cards.retrieval_study import StudySize, measure, table_rows
from ovibjax.report.claims import write_claims
from ovibjax.report.rows import write_rows

TITLE = "Coarse-to-fine retrieval on the sampled multi-scene benchmark"
PRESETS = {
    "smoke": StudySize(2, 240, 24, 1, 2, 60, (10.0, 30.0), (1_000, 2_000), 1),
    "quick": StudySize(5, FRAMES, QUERIES, 2, 5, 2000, (5.0, 10.0, 20.0, 30.0), (5_000, 20_000, 100_000), 3),
    "full": StudySize(
        5, FRAMES, QUERIES, 5, 20, 2000, (5.0, 7.5, 10.0, 15.0, 20.0, 30.0), (5_000, 30_000, 200_000, 1_000_000), 3
    ),
}


def run(job: Job) -> None:
    """Run the card: render, train, sweep, time, tables, claims and figure."""
    started = time.perf_counter()
    found = measure(job, PRESETS[job.preset])
    write_rows(job.out / "table.csv", table_rows(found))
    write_rows(job.out / "growth.csv", found.growth)
    write_claims(job.out / "claims.json", retrieval_claims(found))
    with job.stage("draw"):
        draw(job.out / "figure.png", found)
    caption = retrieval_caption(found)
    job.record(TITLE, caption, found.seeds, started, chosen=list(found.chosen), scenes=found.n_scenes)
