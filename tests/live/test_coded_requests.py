"""Coded prefixes between robots and an edge: what arrives is what the table says, in fewer bytes, or is refused."""

import contextlib
from dataclasses import replace

import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.features.npz import write_npz
from ovibjax.link.coded_packets import CodedRequest, pack_coded
from ovibjax.link.codes.tables import CODES
from ovibjax.link.payload import HEADER_BYTES, Request
from ovibjax.live import messages as m
from ovibjax.live.coded_requests import Sending
from ovibjax.live.edge_file import load_edge, save_edge
from ovibjax.live.framing import WireError
from ovibjax.live.mode_codes import mode_codes
from ovibjax.live.robot_process import sending_of, world_of
from tests.live.edges import a_client, an_edge, run
from tests.live.test_edge_file import raw
from tests.live.test_robot_driver import drive, job_of
from tests.live.test_robot_link import address_of

STATE = m.RobotState(3.0, 0.5, 20.0, 1.5)
SENDINGS = [(code, compact) for code in CODES for compact in (False, True)]


_codes = {}


def codes_of(file):
    """Codes of the references, [modes, R, K]."""
    if file.fingerprint not in _codes:
        _codes[file.fingerprint] = mode_codes(file.params, file.arch, file.reference_x, file.actions)
    return _codes[file.fingerprint]


def a_request(file, row=0, mode="FS", k=16, sequence=1):
    prefix = codes_of(file)[file.actions.modes.index(mode), row, :k]
    return Request(mode, prefix, voi_m=2.0, deadline_ms=60_000, client=3, sequence=sequence)


@pytest.mark.parametrize(("code", "compact"), SENDINGS)
def test_requests_come_back_decoded(edge_file, code, compact):
    sending, floats = Sending(edge_file.coders[code], compact), Sending()
    for row in range(0, len(edge_file.reference_m), 5):
        request = a_request(edge_file, row)
        packet = sending.packet(request)
        found, state = m.unpack_request(m.pack_request(packet, STATE), edge_file.coders)
        received = edge_file.coders[code].decode(edge_file.coders[code].encode(request.prefix), 16)
        assert state == STATE and found == replace(request, prefix=received)
        assert len(packet) < len(floats.packet(request)) + (code == "float32")
        if not compact:
            assert m.unpack_request(packet, edge_file.coders) == (found, m.RobotState())


def test_the_tables_of_a_file_fit_the_codes_of_its_robots(edge_file):
    """Half the places of the grid would be far off, twice as many hardly better."""
    for code, most in (("int8", 0.02), ("int4", 0.3), ("entropy", 0.6)):
        coder, codes = edge_file.coders[code], codes_of(edge_file)[:, :, :16].reshape(-1, 16)
        received = np.stack([coder.decode(coder.encode(one), 16) for one in codes])
        assert np.sqrt(np.mean((received - codes) ** 2)) < most * codes.std()


@pytest.mark.parametrize(("code", "compact"), SENDINGS)
def test_changed_bytes_are_refused_as_every_message_is(edge_file, code, compact):
    rng = np.random.default_rng(0)
    packet = Sending(edge_file.coders[code], compact).packet(a_request(edge_file))
    body, read = m.pack_request(packet, STATE), 0
    for _ in range(300):
        data = bytearray(body)
        data[rng.integers(len(data))] ^= 1 << rng.integers(8)
        cut = data[: rng.integers(len(data))] if rng.random() < 0.3 else data
        if cut == packet:  # a request without its state is one
            continue
        with contextlib.suppress(WireError):
            m.unpack_request(bytes(cut), edge_file.coders)
            read += 1
    assert read == 0


def test_a_code_without_a_table_and_a_stream_of_another_are_refused(edge_file):
    packet = Sending(edge_file.coders["entropy"]).packet(a_request(edge_file))
    with pytest.raises(WireError, match="code entropy is not one of float32"):
        m.unpack_request(packet)
    fields = {"mode": "FS", "k": 16, "voi_m": 1.0, "deadline_ms": 9, "client": 1, "sequence": 1}
    with pytest.raises(WireError, match="no stream of 16"):
        m.unpack_request(pack_coded(CodedRequest(code="entropy", data=b"\xff" * 31, **fields)), edge_file.coders)
    with pytest.raises(WireError, match="finite"):
        m.unpack_request(pack_coded(CodedRequest(code="float32", data=b"\xff" * 64, **fields)), edge_file.coders)


def test_an_edge_answers_codes_as_the_floats_they_stand_for(edge_model):
    file = edge_model.file
    requests = [a_request(file, row, sequence=1 + row) for row in range(4)]

    async def test():
        async with an_edge(edge_model) as server:
            answers = {}
            for code, compact in SENDINGS:
                sending = Sending(file.coders[code], compact)
                async with a_client(server.port) as client:
                    bodies = [m.pack_request(sending.packet(request), STATE) for request in requests]
                    answers[code, compact] = [(await client.ask(body))[0] for body in bodies]
            return answers

    for (code, _), answers in run(test()).items():
        coder, action = file.coders[code], edge_model.action_of("FS", 16)
        for request, answer in zip(requests, answers, strict=True):
            prefix = coder.decode(coder.encode(request.prefix), 16)
            row, _ = edge_model.retrieved(action, edge_model.decoded(action, prefix))
            assert (answer.status, answer.position_m) == ("ok", edge_model.position_m(row))


def test_robots_that_code_ask_as_often_for_fewer_bytes(edge_model, edge_path, edge_file, tmp_path):
    async def test():
        sent = {}
        async with an_edge(edge_model) as server:
            for code, compact in (("float32", False), ("entropy", True)):
                job = job_of(edge_path, server.port, clients=(0, 1), code=code, compact=compact)
                driven = await drive(job, address_of(server, edge_model), edge_file, tmp_path / "log.jsonl")
                sent[code] = driven
        return sent

    sent = run(test())
    per_request = {
        code: sum(one.sent_bytes for one in driven) / sum(one.ended.total() for one in driven)
        for code, driven in sent.items()
    }
    assert any(one.ended["ok"] for one in sent["entropy"])
    assert per_request["entropy"] < 0.65 * per_request["float32"]


def test_a_robot_reckons_with_the_bytes_that_it_sends(edge_file, edge_path):
    job = job_of(edge_path, 1, code="entropy", compact=True)
    actions, plain = world_of(job, edge_file).file.actions, edge_file.actions
    sending = sending_of(job, edge_file)
    a = plain.index("FS", 32)
    real = [len(sending.packet(a_request(edge_file, row, "FS", 32))) for row in range(len(edge_file.reference_m))]
    assert actions.payload_bytes[a] == pytest.approx(np.mean(real), rel=0.1)
    assert (actions.payload_bytes < plain.payload_bytes - HEADER_BYTES).all()
    assert world_of(job_of(edge_path, 1), edge_file).file.actions == plain


def test_a_file_of_an_earlier_version_knows_floats_alone(edge_file, tmp_path):
    path = tmp_path / "earlier.npz"
    save_edge(path, replace(edge_file, tables={}))
    assert not any(name.startswith("code.") for name in np.load(path).files)
    earlier = load_edge(path)
    assert list(earlier.coders) == ["float32"] and earlier.fingerprint != edge_file.fingerprint
    with pytest.raises(InputError, match=r"--code int8: .*edge export"):
        sending_of(job_of(path, 1, code="int8"), earlier)


DAMAGE = {
    "code.int8.step": lambda part: part * 0,
    "code.int4.first": lambda part: part - 40,
    "code.entropy.cumulative": lambda part: part[:, :-1],
    "code.entropy.last": lambda part: part.astype(np.float32),
    "code.int8.cumulative": lambda part: part[1:],
}


@pytest.mark.parametrize("name", DAMAGE)
def test_a_damaged_table_is_refused_in_one_line(edge_path, tmp_path, name):
    arrays, path = raw(edge_path), tmp_path / "damaged.npz"
    write_npz(path, arrays | {name: DAMAGE[name](arrays[name])})
    with pytest.raises(InputError, match=f"table of code {name.split('.')[1]}"):
        load_edge(path)


def test_other_tables_are_another_file(edge_file):
    table = edge_file.tables["int8"]
    other = table._replace(grid=table.grid._replace(step=table.grid.step * np.float32(2)))
    assert replace(edge_file, tables={**edge_file.tables, "int8": other}).fingerprint != edge_file.fingerprint
