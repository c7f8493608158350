"""Wrong key, no key, no certificate, an expired one: refused, one line in the log, no work done."""

import asyncio
import datetime
import ssl
from contextlib import suppress

import pytest
import trustme

from ovibjax.live import trust
from ovibjax.live.messages import Hello, pack_hello, unpack_welcome
from tests.live.edges import a_client, an_edge, events, run
from tests.live.test_edge_server import packet

KEY, NONCE = b"a shared key of the tests", bytes(32)


def hello(client, number=3, key=KEY):
    return pack_hello(Hello(number, NONCE, trust.client_proof(key, client.greeting.nonce, NONCE, number)))


def test_a_robot_with_the_key_is_served(edge_model):
    async def test():
        async with an_edge(edge_model, key=KEY) as server, a_client(server.port) as client:
            assert client.greeting.wants_key
            client.send(hello(client))
            proof = unpack_welcome(await client.message())
            assert proof == trust.server_proof(KEY, client.greeting.nonce, NONCE)
            (answer,) = await client.ask(packet())
            return answer

    assert run(test()).status == "ok"


def replayed(client):
    """A proof that was good on another connection."""
    return pack_hello(Hello(3, NONCE, trust.client_proof(KEY, NONCE, NONCE, 3)))


def of_another_number(client):
    good = hello(client, number=4)
    return good[:4] + b"\x03\x00" + good[6:]


STRANGERS = {
    "wrong key": (lambda client: [hello(client, key=b"another key, as long")], "wrong key"),
    "no key": (lambda client: [packet()], "no proof of the key"),
    "replayed": (lambda client: [replayed(client)], "wrong key"),
    "changed": (lambda client: [of_another_number(client)], "no proof of the key"),
    "number": (lambda client: [hello(client, number=4), packet()], "client 3 on the connection of client 4"),
}


@pytest.mark.parametrize("stranger", STRANGERS)
def test_strangers_are_refused(stranger, edge_model, tmp_path):
    bodies, why = STRANGERS[stranger]
    log = tmp_path / "log.jsonl"

    async def test():
        async with an_edge(edge_model, log, key=KEY) as server:
            async with a_client(server.port) as client:
                client.send(*bodies(client))
                while await client.message() is not None:
                    pass
            return server.counts

    counts = run(test())
    assert counts["requests"] == 0
    assert counts["refused"] == 1
    (line,) = events(log, "refused")
    assert why in line["why"]
    assert line["peer"].startswith("127.0.0.1:")


def test_who_says_nothing_is_dropped(edge_model, tmp_path):
    log = tmp_path / "log.jsonl"

    async def test():
        async with an_edge(edge_model, log, key=KEY, hello_s=0.1) as server, a_client(server.port) as client:
            assert await client.gone()

    run(test())
    assert [line["why"] for line in events(log, "refused")] == ["no hello in time"]


@pytest.fixture(scope="module")
def certificates(tmp_path_factory):
    """An authority, and certificates that it issued."""
    folder, ca, other = tmp_path_factory.mktemp("certificates"), trustme.CA(), trustme.CA()
    past = datetime.datetime.now(datetime.UTC) - datetime.timedelta(days=2)
    issued = {
        "edge": ca.issue_cert("127.0.0.1"),
        "robot": ca.issue_cert("robot.example"),
        "expired": ca.issue_cert("127.0.0.1", not_before=past - datetime.timedelta(days=9), not_after=past),
        "stranger": other.issue_cert("robot.example"),
    }
    paths = {name: folder / f"{name}.pem" for name in (*issued, "ca", "other")}
    for name, cert in issued.items():
        cert.private_key_and_cert_chain_pem.write_to_path(paths[name])
    ca.cert_pem.write_to_path(paths["ca"])
    other.cert_pem.write_to_path(paths["other"])
    return paths


def test_tls_with_certificates_on_both_sides(edge_model, certificates):
    server_tls = trust.server_tls(certificates["edge"], None, certificates["ca"])
    client_tls = trust.client_tls(certificates["ca"], certificates["robot"], None)

    async def test():
        async with (
            an_edge(edge_model, tls=server_tls, key=KEY) as server,
            a_client(server.port, ssl=client_tls) as client,
        ):
            client.send(hello(client))
            await client.message()
            return await client.ask(packet(1), packet(2))

    assert [answer.status for answer in run(test())] == ["ok", "ok"]


@pytest.mark.parametrize("robot", [None, "expired", "stranger"])
def test_robots_without_a_good_certificate_are_refused(robot, edge_model, certificates, tmp_path):
    log = tmp_path / "log.jsonl"
    server_tls = trust.server_tls(certificates["edge"], None, certificates["ca"])
    client_tls = trust.client_tls(certificates["ca"], robot and certificates[robot], None)

    async def test():
        async with an_edge(edge_model, log, tls=server_tls) as server:
            # In TLS 1.3 a client learns that it was refused when it reads.
            with suppress(ConnectionError, ssl.SSLError):
                async with a_client(server.port, ssl=client_tls) as client:
                    assert client.greeting is None
            while not server.counts["refused"]:
                await asyncio.sleep(0.01)
            return server.counts

    counts = run(test())
    assert counts["requests"] == 0
    (line,) = events(log, "refused")
    assert line["why"].startswith("TLS: ")


@pytest.mark.parametrize(("edge", "ca"), [("expired", "ca"), ("edge", "other")])
def test_robots_refuse_an_edge_without_a_good_certificate(edge, ca, edge_model, certificates, tmp_path):
    log = tmp_path / "log.jsonl"
    server_tls = trust.server_tls(certificates[edge], None, None)
    client_tls = trust.client_tls(certificates[ca], None, None)

    async def test():
        async with an_edge(edge_model, log, tls=server_tls) as server:
            with pytest.raises(ssl.SSLCertVerificationError):
                async with a_client(server.port, ssl=client_tls):
                    pass
            while not server.counts["refused"]:
                await asyncio.sleep(0.01)

    run(test())
    assert len(events(log, "refused")) == 1


@pytest.mark.parametrize("first", [b"\x17\x03\x03\x00\x10" + bytes(16), b"GET / HTTP/1.1\r\n\r\n", b""])
def test_who_does_not_speak_tls_is_dropped(first, edge_model, certificates, tmp_path):
    log = tmp_path / "log.jsonl"
    server_tls = trust.server_tls(certificates["edge"], None, None)

    async def test():
        async with an_edge(edge_model, log, tls=server_tls, hello_s=0.3) as server:
            reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
            writer.write(first)
            with suppress(ConnectionError):
                while await reader.read(4096):
                    pass
            writer.close()
            client_tls = trust.client_tls(certificates["ca"], None, None)
            async with a_client(server.port, ssl=client_tls) as client:
                (answer,) = await client.ask(packet())
            return answer

    assert run(test()).status == "ok"
    (line,) = events(log, "refused")
    assert line["why"].startswith("TLS: ")
