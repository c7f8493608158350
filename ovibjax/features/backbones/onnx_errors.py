"""What onnxruntime says when a model does not load or run, cut down to the cause, with what can be done."""

import re
from pathlib import PurePath

_KIND = re.compile(r"^\[ONNXRuntimeError\] : \d+ : \w+ : ")
_PLACE = re.compile(r"\S+\.(?:cc|cpp|h|hpp):\d+ (?:[^()]{0,300}\([^()]*\)(?: const)? |\w+ )?")
_LOADING = re.compile(r"^Load model from .*? failed:")
_IR = re.compile(r"Unsupported model IR version: (\d+), max supported IR version: (\d+)")
_OPSET = re.compile(r"Opset (\d+) is under development.* domain (\S+) is till opset (\d+)")
_WEIGHTS = re.compile(r"External data path does not exist: \"?([^\"]+)\"?")
_SHORT = re.compile(r"External initializer: (\S+) offset: (\d+) size to read: (\d+) given file_length: (\d+)")
_OPERATOR = re.compile(r"No Op registered for (\w+)")
_MAX_CHARS = 200


def cause_of(error: BaseException, version: str) -> str:
    """The cause of a failure in a few words.

    Args:
        error: as onnxruntime raised it; its message begins with places in its own source code.
        version: of onnxruntime.

    Returns:
        One line.
    """
    text = _LOADING.sub("", _KIND.sub("", " ".join(str(error).split())))
    newer = f"this onnxruntime {version} reads up to"
    remedy = "pip install -U onnxruntime, or export the model for an older one"
    if found := _IR.search(text):
        return f"IR version {found[1]}, {newer} {found[2]}: {remedy}"
    if found := _OPSET.search(text):
        return f"opset {found[1]} of {found[2]}, {newer} {found[3]}: {remedy}"
    if found := _WEIGHTS.search(text):
        return f"its weights are in {PurePath(found[1]).name}, which is not there: copy that file too"
    if found := _SHORT.search(text):
        needed = int(found[2]) + int(found[3])
        return f"the file with its weights has {found[4]} bytes, {found[1]} needs {needed}: copy that file again"
    if found := _OPERATOR.search(text):
        return f"it needs the operator {found[1]}, which onnxruntime {version} does not have"
    cause = _PLACE.sub("", text).strip() or text
    return cause if len(cause) <= _MAX_CHARS else cause[: _MAX_CHARS - 3] + "..."
