"""What the tests of the link share."""

import jax
import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.link import channel
from ovibjax.link.payload import Request
from ovibjax.link.trace_files import read_trace

KEY = jax.random.key(7)
K_FACTORS = [0.0, 0.5, 4.0, 50.0]
fading_power = jax.jit(channel.fading_power, static_argnums=1)

# Repeats the documented table and shares no constant with the code under test.
WIRE_MODES = {"F": (0, [0]), "FS": (1, [0, 2, 3]), "H4": (2, [0, 1, 2, 3]), "A5": (3, [0, 1, 2, 3, 4])}


def written(path, content):
    """A file of this text or these bytes."""
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def refused(path, content, **options):
    """The one line with which a trace of this content is refused."""
    with pytest.raises(InputError) as caught:
        read_trace(written(path, content), **options)
    message = str(caught.value)
    assert message.isprintable() and len(message) < 450
    return message


def sample(mode="FS", k=3, **changes):
    """A request with these changes."""
    prefix = np.linspace(-1.0, 2.0, k, dtype=np.float32)
    fields = {"voi_m": 1.5, "deadline_ms": 500, "client": 7, "sequence": 258} | changes
    return Request(mode, fields.pop("prefix", prefix), **fields)
