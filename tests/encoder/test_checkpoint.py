"""The checkpoint that is trained without labels: its mixed frames, its key."""

import jax
import numpy as np

from ovibjax.encoder.checkpoint import mix_frames, train_checkpoint
from tests.control.cases import TINY, drive


def test_mixed_frames():
    x = jax.random.normal(jax.random.key(0), (6, 2, 3))
    assert mix_frames(jax.random.key(1), x, 0) is x
    mixed = mix_frames(jax.random.key(1), x, 40)
    assert mixed.shape == (46, 2, 3)
    np.testing.assert_array_equal(mixed[:6], x)
    rows = np.asarray(x, np.float64).reshape(6, -1)
    for new in np.asarray(mixed[6:], np.float64).reshape(40, -1):
        # Some triple and one weight in [0, 1] give it.
        gaps = []
        for i in range(6):
            for j in range(6):
                for k in range(6):
                    way = rows[j] - rows[k]
                    weight = 0.0 if j == k else np.clip((new - rows[i]) @ way / (way @ way), 0, 1)
                    gaps.append(np.abs(rows[i] + weight * way - new).max())
        assert min(gaps) < 1e-5


def test_training_is_a_function_of_its_key():
    frames = drive(4)
    one, two = (train_checkpoint(jax.random.key(5), frames.features, TINY) for _ in range(2))
    jax.tree.map(np.testing.assert_array_equal, one.params, two.params)
