"""Fig. "Scalable encoder ablations": orthogonality weight, coordinate orderings, components; Lemmas and Proposition."""

import time
from dataclasses import dataclass

from ovibjax.cards.ablation_claims import PAPER_M, K, judge_claims
from ovibjax.cards.ablation_drawing import draw
from ovibjax.cards.ablation_study import Ablation, ablate, table_rows
from ovibjax.cards.alpha_study import alpha_effects, metres_alpha
from ovibjax.cards.job import Job
from ovibjax.cards.recipe_study import RECIPE_VARIANTS
from ovibjax.encoder.loss import GAMMA
from ovibjax.encoder.model import Architecture
from ovibjax.encoder.train import TrainConfig
from ovibjax.encoder.training_data import member_data
from ovibjax.report import figures as fig
from ovibjax.report.claims import write_claims
from ovibjax.report.rows import write_rows
from ovibjax.runtime.precision_choice import faster_precision

TITLE = "Scalable encoder ablations"


@dataclass(frozen=True)
class Preset:
    """Size of the ablation.

    Attributes:
        seeds: number of seeds.
        steps: training steps; by the number of frames if None (`encoder.recipe`).
        gammas: positive orthogonality weights.
        recipe: changes of the recipe that are trained.
        ks: prefixes judged.
        alphas: weights of localization beside the paper's and that of square metres.
        alpha_seeds: seeds on which they are tried.
    """

    seeds: int
    steps: int | None
    gammas: tuple[float, ...]
    recipe: tuple[str, ...]
    ks: tuple[int, ...]
    alphas: tuple[float, ...]
    alpha_seeds: int


_MOST_TELLING = ("no_linear_start", "paper_recipe", "pca_completed")

PRESETS = {
    "smoke": Preset(2, 30, (0.1, 1.0), ("no_linear_start", "paper_recipe", "pca_completed"), (16, 35, 128), (), 2),
    "quick": Preset(3, None, (0.1, 1.0), _MOST_TELLING, (4, 8, 16, 24, 35, 64, 96, 128), (), 3),
    "full": Preset(
        4,
        None,
        (0.01, 0.1, 1.0, 10.0),
        RECIPE_VARIANTS,
        (1, 2, 3, 4, 6, 8, 10, 12, 14, 16, 20, 24, 28, 32, 35, 40, 48, 56, 64, 72, 80, 88, 96, 104, 112, 120, 124, 128),
        (100.0,),
        3,
    ),
}


def run(job: Job) -> None:
    """Run the card: train all variants, judge orderings, write table, claims and figure."""
    started = time.perf_counter()
    preset = PRESETS[job.preset]
    seeds = [job.seed + i for i in range(preset.seeds)]
    with job.stage("features"):
        members = [member_data(job.features, seed, job.rank)[0] for seed in seeds]
    views, dim = members[0].train.x.shape[1:]
    arch = Architecture(n_views=views, view_dim=dim)
    static = TrainConfig(arch, steps=preset.steps, precision=faster_precision())
    steps = static.steps_on(len(members[0].train.x))
    with job.stage("judge"):
        found = ablate(job.sweep, static, preset.gammas, preset.recipe, preset.ks, members, seeds)
        alphas = (*preset.alphas, metres_alpha(members))
        some = slice(preset.alpha_seeds)
        effects = alpha_effects(job.sweep, static, found.trained, alphas, members[some], seeds[some])
        claims = judge_claims(preset.gammas, found, effects)
    write_rows(job.out / "table.csv", table_rows(found))
    write_rows(job.out / "alpha.csv", effects.rows())
    write_claims(job.out / "claims.json", claims)
    with job.stage("draw"):
        draw(job.out / "figure.png", found, effects, preset.gammas, K, PAPER_M)
    job.record(
        *(TITLE, caption(preset, steps, static.precision, found), seeds, started),
        steps=steps,
        precision=static.precision,
        selected_gamma=found.selected_gamma(K),
        diverged=int(found.trained.diverged.sum()),
        members_of_an_earlier_run=int(found.trained.attrs["resumed"]),
    )


def caption(preset: Preset, steps: int, precision: str, found: Ablation) -> str:
    """What the reader of the figure needs to know."""
    orthogonal = found.spectra[GAMMA]
    return (
        f"Trained {steps} steps per member, {precision} products. "
        f"{fig.spread(preset.seeds)} (split, initialisation, minibatches; common to all variants). (a) Orthogonality "
        f"weight at k = {K}; star: selected on validation among γ > 0. (b) Coordinates of Full (γ = {GAMMA:g}, "
        "β = 0.001) kept in other orders; dark bands: 95 % intervals over the test frames of a seed. (c) Components at "
        f"k = {K} (bars) and 16 (circles), each trained separately; purple: what our recipe adds to the paper's, each "
        "taken away alone, and all of it in the paper's recipe (50 epochs, batches of 512, rate 1e-3); black ticks: "
        "the paper's values on its own data. (d) Zoom: paired difference to Full, a grey dot per seed. (e), (f) Error "
        "without a term minus error with it, by the weight α of localization, on "
        f"{min(preset.alpha_seeds, preset.seeds)} seeds; the last α weighs square metres, the others standardised "
        f"positions. Singular values of W at γ = {GAMMA:g}: {orthogonal.values.min():.2f} to "
        f"{orthogonal.values.max():.2f}."
    )
