from .framing import FrameReader as FrameReader
from .framing import WireError as WireError
from .framing import frame as frame
from .messages import Answer as Answer
from .messages import RobotState as RobotState
from .messages import pack_answer as pack_answer
from .messages import pack_request as pack_request
from .messages import unpack_answer as unpack_answer
from .messages import unpack_request as unpack_request

__all__ = [
    "Answer",
    "FrameReader",
    "RobotState",
    "WireError",
    "frame",
    "pack_answer",
    "pack_request",
    "unpack_answer",
    "unpack_request",
]
