"""View order, view modes and view masks (paper, Section "Scalable View-Rate Encoding")."""

import jax
import jax.numpy as jnp

VIEWS: tuple[str, ...] = ("Front", "Back", "Left", "Right", "Down")
"""Camera names in feature order; a UGV carries the first four."""

MODES: dict[str, tuple[int, ...]] = {
    "F": (0,),
    "FS": (0, 2, 3),
    "H4": (0, 1, 2, 3),
    "A5": (0, 1, 2, 3, 4),
}
"""Admissible view modes: front, front plus sides, four horizontal, all five."""


def modes_for(n_views: int) -> tuple[str, ...]:
    """Modes a platform supports: all four for a UAV (5 views), F, FS and H4 for a UGV (4 views).

    Args:
        n_views: cameras on the platform, 4 or 5.

    Returns:
        Mode names, in the order of `MODES`.

    Raises:
        ValueError: no platform of the paper has that many views.
    """
    if n_views not in (4, 5):
        raise ValueError(f"a platform has 5 views (UAV) or 4 (UGV: Front Back Left Right), not {n_views}")
    return tuple(name for name, views in MODES.items() if max(views) < n_views)


def full_mode(n_views: int) -> str:
    """The mode that uses every view of the platform: A5 for 5 views, H4 for 4."""
    return modes_for(n_views)[-1]


def mode_mask(mode: str, n_views: int = 5) -> jax.Array:
    """Binary view mask m_S of a mode.

    Args:
        mode: a key of `MODES`.
        n_views: length M of the mask.

    Returns:
        [M] float32, one where the view is sent.

    Raises:
        ValueError: the mode is unknown or needs a view the platform lacks.

    Example:
        >>> mode_mask("FS").tolist()  # front, left and right
        [1.0, 0.0, 1.0, 1.0, 0.0]
    """
    if mode not in modes_for(n_views):
        raise ValueError(f"view mode {mode!r} is not one of {', '.join(modes_for(n_views))}")
    return jnp.zeros(n_views, jnp.float32).at[jnp.array(MODES[mode])].set(1.0)


def mask_table(n_views: int = 5) -> jax.Array:
    """Masks of all supported modes.

    Returns:
        [modes, M] float32, rows in the order of `modes_for(n_views)`.
    """
    return jnp.stack([mode_mask(mode, n_views) for mode in modes_for(n_views)])
