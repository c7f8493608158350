"""How the scalable encoder is trained unless one says otherwise: for how long, and on which prefixes.

Chosen by the time to a given error on tuning seeds 0 to 3 of the embedded town; `TrainConfig` and `Architecture` hold
the rest of it. What it was chosen against, with the errors, stands in tests/benchmarks/recipe.md.
"""

PAPER_PREFIXES = (4, 8, 16, 32, 64, 96, 128)
"""Supported prefix lengths of the scalable encoder (paper, Section "Experimental Setup")."""

PAPER_EPOCHS, PAPER_BATCH, PAPER_LR = 50, 512, 1e-3
"""The paper's own recipe: "The Town05 scalable encoder uses K = 128, 𝒦 = {4, 8, 16, 32, 64, 96, 128}, 50 AdamW epochs,
batch size 512, learning rate 10⁻³, and (α, β, γ) = (1, 10⁻³, 0.1)" (Section "Experimental Setup"); see
`train.paper_recipe`."""

PREFIX_SHARES = {4: 1, 8: 5, 12: 5, 16: 10, 20: 5, 24: 7, 32: 4, 48: 2}
"""How often each length below K is drawn, against twice for K itself.

Drawn evenly, prefixes too short to localize at all (k = 4) take from those that can, and long ones, which a decoder
that completes the prefix keeps for nothing, take from short ones.
"""

SHORTEST_FOR_BITS = 8
"""Shortest length that is drawn in training for bits: four rounded coordinates localize nothing."""

EPOCHS = 75
MIN_STEPS, MAX_STEPS = 400, 10_000
"""The one rule for the length of a training: so many passes over the training examples, within these bounds."""


def training_prefixes(latent: int = PAPER_PREFIXES[-1]) -> tuple[int, ...]:
    """Prefix lengths to draw from, as often as they stand here.

    Args:
        latent: full latent dimension K.

    Returns:
        The lengths below K of `PREFIX_SHARES`, and K.
    """
    short = (k for k, share in PREFIX_SHARES.items() if k < latent for _ in range(share))
    return (*short, latent, latent)


def training_steps(n: int, batch: int) -> int:
    """Steps of a training whose length is not given.

    Args:
        n: training examples.
        batch: examples per step.

    Returns:
        The steps of `EPOCHS` epochs, within `MIN_STEPS` and `MAX_STEPS`.
    """
    return min(max(EPOCHS * (n // min(batch, n)), MIN_STEPS), MAX_STEPS)
