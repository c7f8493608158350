"""A stream in any pieces gives the same frames; a length that cannot be is refused before it is held."""

import itertools
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ovibjax.live.framing import FrameReader, WireError, frame
from tests.live.cases import patient

bodies = st.lists(st.binary(min_size=1, max_size=40), max_size=12)


@patient
@given(bodies, st.lists(st.integers(0, 200), max_size=20))
def test_pieces_of_any_size_give_the_same_frames(sent, cuts):
    stream = b"".join(map(frame, sent))
    reader, found = FrameReader(40), []
    ends = sorted({0, len(stream), *(cut % (len(stream) + 1) for cut in cuts)})
    for start, end in itertools.pairwise(ends):
        found += reader.feed(stream[start:end])
    assert found == sent
    assert reader.held == b""


@patient
@given(bodies, st.binary(min_size=1, max_size=40))
def test_a_frame_that_is_not_complete_is_kept(sent, last):
    whole = frame(last)
    reader = FrameReader(40)
    assert reader.feed(b"".join(map(frame, sent)) + whole[:-1]) == sent
    assert reader.held == whole[:-1]
    assert reader.feed(whole[-1:]) == [last]


@pytest.mark.parametrize("length", [0, 41, 2**31, 2**32 - 1])
def test_a_length_that_cannot_be_is_refused_at_once(length):
    with pytest.raises(WireError, match=f"frame of {length} bytes"):
        FrameReader(40).feed(struct.pack("<I", length))


@patient
@given(st.lists(st.binary(max_size=300), max_size=8))
def test_no_bytes_do_anything_else(pieces):
    reader = FrameReader(40)
    for piece in pieces:
        try:
            frames = reader.feed(piece)
        except WireError:
            return
        assert all(1 <= len(body) <= 40 for body in frames)
        assert len(reader.held) < 4 + 40
