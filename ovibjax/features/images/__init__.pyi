from .by_path import open_source as open_source
from .codecs import CODECS as CODECS
from .codecs import LADDERS as LADDERS
from .codecs import decode as decode
from .codecs import encode as encode
from .decoding import decode_image as decode_image
from .extraction import Extraction as Extraction
from .extraction import extract as extract
from .source import Frame as Frame
from .source import Skipped as Skipped
from .source import Source as Source

__all__ = [
    "CODECS",
    "LADDERS",
    "Extraction",
    "Frame",
    "Skipped",
    "Source",
    "decode",
    "decode_image",
    "encode",
    "extract",
    "open_source",
]
