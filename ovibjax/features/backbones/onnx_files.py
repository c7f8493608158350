"""Which files an ONNX model reads: itself, and those that hold the tensors it keeps elsewhere, whatever their names.

The few fields of onnx.proto that lead to a tensor are walked in the wire format of protocol buffers; weights are
stepped over, so that a model of gigabytes takes no time and no memory.
"""

import mmap
from collections.abc import Iterator
from pathlib import Path

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5

# Message and field to the message in that field (numbers from onnx.proto).
_CHILDREN = {
    ("model", 7): "graph",
    ("model", 25): "function",
    ("graph", 1): "node",
    ("graph", 5): "tensor",
    ("graph", 15): "sparse",
    ("function", 7): "node",
    ("node", 5): "attribute",
    ("attribute", 5): "tensor",
    ("attribute", 6): "graph",
    ("attribute", 10): "tensor",
    ("attribute", 11): "graph",
    ("attribute", 22): "sparse",
    ("attribute", 23): "sparse",
    ("sparse", 1): "tensor",
    ("sparse", 2): "tensor",
    ("tensor", 13): "entry",
}
_MAX_DEPTH = 64


def model_files(path: Path) -> list[Path]:
    """The files whose content decides what a model computes.

    Args:
        path: a model that onnxruntime has loaded.

    Returns:
        The model, then the files its tensors lie in, by name. Where the file is no protocol buffer (onnxruntime has a
        format of its own), every file beside it whose name begins as the model's does.

    Raises:
        OSError: it cannot be read.
    """
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            view = memoryview(content)
            try:
                places = set(_locations(view, "model", 0))
            finally:
                view.release()
    except ValueError:
        beside = sorted(part for part in path.parent.iterdir() if part.name.startswith(path.stem) and part.is_file())
        return [path, *(part for part in beside if part != path)]
    return [path, *(path.parent / place for place in sorted(places))]


def _locations(message: memoryview, kind: str, depth: int) -> Iterator[str]:
    """Names of files, relative to the model's folder, in a message and those within it."""
    if depth > _MAX_DEPTH:
        raise ValueError("nested too deeply")
    for number, value in _fields(message):
        child = _CHILDREN.get((kind, number))
        if child is None or not isinstance(value, memoryview):
            continue
        if child != "entry":
            yield from _locations(value, child, depth + 1)
            continue
        pair = {key: bytes(text).decode() for key, text in _fields(value) if isinstance(text, memoryview)}
        if pair.get(1) == "location":
            yield pair.get(2, "")


def _fields(message: memoryview) -> Iterator[tuple[int, memoryview | int]]:
    """Numbers and values of a message's fields; ValueError where it is no message."""
    at = 0
    while at < len(message):
        tag, at = _varint(message, at)
        number, wire = tag >> 3, tag & 7
        if wire == _VARINT:
            value, at = _varint(message, at)
            yield number, value
            continue
        length, at = _varint(message, at) if wire == _BYTES else ({_FIXED64: 8, _FIXED32: 4}.get(wire, -1), at)
        if number == 0 or length < 0 or at + length > len(message):
            raise ValueError("not a protocol buffer")
        if wire == _BYTES:
            part = message[at : at + length]
            try:
                yield number, part
            finally:
                part.release()
        at += length


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    """A number of variable length, and where it ends."""
    number = 0
    for place in range(10):
        if at + place >= len(message):
            break
        byte = message[at + place]
        number |= (byte & 0x7F) << 7 * place
        if byte < 0x80:
            return number, at + place + 1
    raise ValueError("not a protocol buffer")
