"""Tiny ONNX models written byte by byte, so that the tests need no further package (onnx.proto has the numbers)."""

import numpy as np

FLOAT, INT64 = 1, 7


def _varint(number: int) -> bytes:
    out = bytearray()
    while True:
        number, low = number >> 7, number & 0x7F
        out.append(low | (0x80 if number else 0))
        if not number:
            return bytes(out)


def _field(number: int, value: int | str | bytes) -> bytes:
    if isinstance(value, int):
        return _varint(number << 3) + _varint(value)
    content = value.encode() if isinstance(value, str) else value
    return _varint(number << 3 | 2) + _varint(len(content)) + content


def _value(name: str, shape: tuple[int | str, ...] | None, kind: int = FLOAT) -> bytes:
    if shape is None:
        return _field(1, name) + _field(2, _field(1, _field(1, kind)))
    dims = b"".join(_field(1, _field(1 if isinstance(n, int) else 2, n)) for n in shape)
    return _field(1, name) + _field(2, _field(1, _field(1, kind) + _field(2, dims)))


def _node(op: str, inputs: tuple[str, ...], output: str) -> bytes:
    return b"".join(_field(1, name) for name in inputs) + _field(2, output) + _field(4, op)


def _tensor(name: str, array: np.ndarray) -> bytes:
    dims = b"".join(_field(1, n) for n in array.shape)
    kind, dtype = (INT64, "<i8") if array.dtype.kind == "i" else (FLOAT, "<f4")
    return dims + _field(2, kind) + _field(8, name) + _field(9, array.astype(dtype).tobytes())


def external(name: str, shape: tuple[int, ...], location: str, offset: int = 0) -> bytes:
    """A tensor whose numbers lie in another file."""
    pairs = {"location": location, "offset": str(offset), "length": str(4 * int(np.prod(shape)))}
    entries = b"".join(_field(13, _field(1, key) + _field(2, value)) for key, value in pairs.items())
    return b"".join(_field(1, n) for n in shape) + _field(2, FLOAT) + _field(8, name) + entries + _field(14, 1)


def model(nodes, weights, inputs, outputs) -> bytes:
    """A model from (op, inputs, output) nodes, named weights, and (name, shape[, kind]) inputs and outputs.

    Weights are arrays, or tensors of `external`.
    """
    graph = b"".join(_field(1, _node(*node)) for node in nodes) + _field(2, "g")
    tensors = [part if isinstance(part, bytes) else _tensor(name, part) for name, part in weights.items()]
    graph += b"".join(_field(5, tensor) for tensor in tensors)
    graph += b"".join(_field(11, _value(*entry)) for entry in inputs)
    graph += b"".join(_field(12, _value(*entry)) for entry in outputs)
    return _field(1, 8) + _field(7, graph) + _field(8, _field(2, 13))


def pooled_product(weight: np.ndarray, shape: tuple[int | str, ...] = ("n", 3, "h", "w")) -> bytes:
    """Channel means times a matrix; outputs in order: map [N, 3, 1, 1], pooled [N, 3], feature [N, d]."""
    nodes = [
        ("GlobalAveragePool", ("image",), "map"),
        ("Flatten", ("map",), "pooled"),
        ("MatMul", ("pooled", "weight"), "feature"),
    ]
    outputs = [("map", (shape[0], 3, 1, 1)), ("pooled", (shape[0], 3)), ("feature", (shape[0], weight.shape[1]))]
    return model(nodes, {"weight": weight}, [("image", shape)], outputs)


def external_product(shape: tuple[int, int], location: str) -> bytes:
    """Channel means times a matrix that lies in another file."""
    nodes = [("GlobalAveragePool", ("image",), "map"), ("Flatten", ("map",), "pooled")]
    nodes += [("MatMul", ("pooled", "weight"), "feature")]
    weights = {"weight": external("weight", shape, location)}
    return model(nodes, weights, [("image", ("n", 3, "h", "w"))], [("feature", ("n", shape[1]))])


def with_versions(content: bytes, ir: int = 8, opset: int = 13) -> bytes:
    """A model of `model` that claims other versions."""
    head, tail = _field(1, 8), _field(8, _field(2, 13))
    return _field(1, ir) + content[len(head) : -len(tail)] + _field(8, _field(2, opset))


def reshaped(*shapes: tuple[int, ...], declared: bool = True) -> bytes:
    """The image in other shapes, an output each; 0 keeps the batch."""
    nodes = [("Reshape", ("image", f"shape{n}"), f"out{n}") for n in range(len(shapes))]
    weights = {f"shape{n}": np.array(shape) for n, shape in enumerate(shapes)}
    outputs = [(f"out{n}", ("n", *shape[1:]) if declared else None) for n, shape in enumerate(shapes)]
    return model(nodes, weights, [("image", ("n", 3, 4, 4))], outputs)


def flat_product(weight: np.ndarray, shape: tuple[int | str, ...]) -> bytes:
    """All pixels times a matrix, [N, d]."""
    nodes = [("Flatten", ("image",), "flat"), ("MatMul", ("flat", "weight"), "feature")]
    return model(nodes, {"weight": weight}, [("image", shape)], [("feature", (shape[0], weight.shape[1]))])
