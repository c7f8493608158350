"""JSON values compared: what differs, in words; one spelling; a digest."""

import hashlib
import json
from collections.abc import Iterator
from typing import Any

_ABSENT = object()


def differences(there: Any, here: Any, name: str = "") -> Iterator[str]:
    """What differs between two JSON values, each with its dotted path."""
    if isinstance(there, dict) and isinstance(here, dict):
        for key in {**there, **here}:
            yield from differences(there.get(key, _ABSENT), here.get(key, _ABSENT), f"{name}.{key}" if name else key)
    elif isinstance(there, list) and isinstance(here, list) and _itemwise(there, here):
        for i, pair in enumerate(zip(there, here, strict=True)):
            yield from differences(*pair, f"{name}[{i}]")
    elif there is _ABSENT or here is _ABSENT or canonical(there) != canonical(here):
        yield f"{name} is {_show(there)} there and {_show(here)} here"


def _itemwise(there: list[Any], here: list[Any]) -> bool:
    """Whether two lists are better compared item by item than shown whole."""
    return len(there) == len(here) and (len(there) > 4 or any(isinstance(v, dict | list) for v in there))


def _show(value: Any) -> str:
    """A value on one short line."""
    if value is _ABSENT:
        return "absent"
    if isinstance(value, list) and len(value) > 4:
        return f"[{_show(value[0])}, {_show(value[1])}, ... {_show(value[-1])}] ({len(value)} values)"
    text = json.dumps(value)
    return text if len(text) <= 80 else f"{text[:60]}...{text[-15:]}"


def canonical(value: Any) -> str:
    """JSON in one spelling."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"))


def digest(config: Any) -> str:
    """SHA-256 of a configuration."""
    return hashlib.sha256(canonical(config).encode()).hexdigest()
