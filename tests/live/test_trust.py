"""Keys and proofs; what is wrong with a file of a key or a certificate is said in one line."""

import hashlib
import hmac

import pytest

from ovibjax.errors import InputError
from ovibjax.live import trust

KEY = b"k" * 32
NONCES = bytes(range(32)), bytes(range(32, 64))


def test_proofs_are_hmacs_of_all_that_was_said():
    text = b"ovibjax edge 1 client" + NONCES[0] + NONCES[1] + (513).to_bytes(2, "little")
    assert trust.client_proof(KEY, *NONCES, 513) == hmac.new(KEY, text, hashlib.sha256).digest()
    text = b"ovibjax edge 1 server" + NONCES[0] + NONCES[1]
    assert trust.server_proof(KEY, *NONCES) == hmac.new(KEY, text, hashlib.sha256).digest()


def test_another_key_nonce_or_number_is_another_proof():
    proofs = {
        trust.client_proof(KEY, *NONCES, 1),
        trust.client_proof(KEY[::-1] + b"x", *NONCES, 1),
        trust.client_proof(KEY, *NONCES[::-1], 1),
        trust.client_proof(KEY, *NONCES, 2),
        trust.server_proof(KEY, *NONCES),
    }
    assert len(proofs) == 5
    assert trust.same(trust.client_proof(KEY, *NONCES, 1), trust.client_proof(KEY, *NONCES, 1))


def test_a_key_is_what_stands_in_its_file(tmp_path):
    path = tmp_path / "edge.key"
    path.write_bytes(b"  " + KEY + b"\n")
    assert trust.read_key(path) == KEY
    assert trust.read_key(None) is None


@pytest.mark.parametrize("content", [b"", b"short", b"x" * 5000])
def test_no_key_is_named(tmp_path, content):
    path = tmp_path / "edge.key"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"edge\.key: a key has 16 to 4096 bytes"):
        trust.read_key(path)


def test_a_missing_key_is_named(tmp_path):
    with pytest.raises(InputError, match="none: the key cannot be read"):
        trust.read_key(tmp_path / "none")


def test_parts_of_tls_need_one_another(tmp_path):
    assert trust.server_tls(None, None, None) is None
    assert trust.client_tls(None, None, None) is None
    with pytest.raises(InputError, match="--tls-key belongs to --tls-cert"):
        trust.server_tls(None, tmp_path / "key", None)
    with pytest.raises(InputError, match="--tls-cert belongs to --tls-ca"):
        trust.client_tls(None, tmp_path / "cert", None)


@pytest.mark.parametrize("content", [b"", b"not a certificate", b"\0\xff" * 100])
def test_files_that_are_no_certificates_are_named(tmp_path, content):
    path = tmp_path / "file.pem"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"file\.pem: no certificate"):
        trust.server_tls(path, None, None)
    with pytest.raises(InputError, match=r"file\.pem: no certificate"):
        trust.client_tls(path, None, None)
    with pytest.raises(InputError, match=r"cannot be read"):
        trust.client_tls(tmp_path / "none", None, None)


@pytest.mark.parametrize(
    ("hosts", "loopback"),
    [(["127.0.0.1"], True), (["::1", "localhost"], True), (["0.0.0.0"], False), (["127.0.0.1", "10.0.0.1"], False)],
)
def test_loopback(hosts, loopback):
    assert trust.is_loopback(hosts) is loopback
