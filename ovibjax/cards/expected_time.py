"""How long each figure takes on a reference machine, and from that and what was seen so far, how long the rest will."""

from collections.abc import Mapping, Sequence

from ovibjax.cards.job import PRESETS

REFERENCE_S: dict[str, tuple[float, float, float]] = {
    "adaptation": (25.0, 40.0, 40.0),
    "bytes": (100.0, 200.0, 700.0),
    "encoder_ablation": (20.0, 190.0, 391.0),
    "live": (60.0, 210.0, 680.0),
    "multi_client": (45.0, 45.0, 85.0),
    "real_scene": (41.0, 41.0, 59.0),
    "request_control": (1.0, 2.0, 1.0),
    "retrieval": (18.0, 65.0, 170.0),
    "scalable_compression": (40.0, 59.0, 294.0),
    "setup": (11.0, 4.0, 2.0),
    "single_scene_ib": (36.0, 101.0, 229.0),
    "system_grid": (25.0, 44.0, 84.0),
    "theorem": (5.0, 6.0, 15.0),
    "view_rate_selection": (0.5, 2.0, 0.5),
    "voi_predictor": (1.0, 2.0, 1.0),
    "voi_timing": (1.0, 1.0, 0.5),
    "walkthrough": (35.0, 15.0, 17.0),
    "weights": (23.0, 19.0, 27.0),
}
"""Seconds by card, one per preset of `PRESETS`, of a whole run with nothing compiled before; only their ratios count.

Measured on two cores (x86 with AVX-512).
Cards that share a study are listed as they run, by name: the first pays for it."""


def remaining_s(preset: str, seen_s: Mapping[str, float], left: Sequence[str]) -> float | None:
    """Seconds that figures will take if the rest of a run is as much slower than the reference as what was seen.

    Args:
        preset: one of `PRESETS`.
        seen_s: seconds by card that is finished.
        left: cards to come.

    Returns:
        Seconds; None if no finished card or a card to come is not in the table.
    """
    column = PRESETS.index(preset)
    expected_s = {name: row[column] for name, row in REFERENCE_S.items()}
    known = [name for name in seen_s if name in expected_s]
    if not known or any(name not in expected_s for name in left):
        return None
    slower = sum(seen_s[name] for name in known) / sum(expected_s[name] for name in known)
    return slower * sum(expected_s[name] for name in left)


def in_words(seconds: float) -> str:
    """A rough time, such as "some 6 min"."""
    if seconds < 90:
        return f"some {max(5, 5 * round(seconds / 5))} s"
    return f"some {seconds / 60:.0f} min" if seconds < 100 * 60 else f"some {seconds / 3600:.1f} h"
