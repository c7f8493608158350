from . import codes as codes
from .channel import draw_gain as draw_gain
from .channel import fading_power as fading_power
from .channel import make_channel_params as make_channel_params
from .channel import rate_bps as rate_bps
from .coded_packets import CodedRequest as CodedRequest
from .coded_packets import pack_coded as pack_coded
from .coded_packets import pack_compact as pack_compact
from .coded_packets import unpack_coded as unpack_coded
from .latency import JETSON as JETSON
from .latency import kbytes_per_s as kbytes_per_s
from .latency import semantic_latency_ms as semantic_latency_ms
from .latency import transmit_s as transmit_s
from .payload import PayloadError as PayloadError
from .payload import Request as Request
from .payload import pack as pack
from .payload import request_bytes as request_bytes
from .payload import unpack as unpack
from .profiles import profile_rate_bps as profile_rate_bps
from .trace_files import read_trace as read_trace
from .traces import Trace as Trace
from .traces import resample as resample

__all__ = [
    "JETSON",
    "CodedRequest",
    "PayloadError",
    "Request",
    "Trace",
    "codes",
    "draw_gain",
    "fading_power",
    "kbytes_per_s",
    "make_channel_params",
    "pack",
    "pack_coded",
    "pack_compact",
    "profile_rate_bps",
    "rate_bps",
    "read_trace",
    "request_bytes",
    "resample",
    "semantic_latency_ms",
    "transmit_s",
    "unpack",
    "unpack_coded",
]
