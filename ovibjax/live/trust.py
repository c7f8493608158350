"""Who may talk to an edge: a shared key with a challenge, and TLS.

The key says who connects. It does not protect what is sent after that: on a network where somebody may change bytes or
read them, use TLS, alone or with the key.
"""

import hmac
import ssl
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path

from ovibjax.errors import InputError, refusal, unreadable

KEY_MIN_BYTES, KEY_MAX_BYTES = 16, 4096

_CLIENT, _SERVER = b"ovibjax edge 1 client", b"ovibjax edge 1 server"


def read_key(path: Path | None) -> bytes | None:
    """The shared key in a file, without spaces and line breaks around it; None without a file.

    Args:
        path: the file, of 16 to 4,096 bytes.

    Returns:
        The key.

    Raises:
        InputError: the file cannot be read, or is too short or too long for a key.
    """
    if path is None:
        return None
    try:
        with path.open("rb") as file:
            key = file.read(KEY_MAX_BYTES + 1).strip()
    except OSError as error:
        raise refusal(path, f"the key cannot be read ({error.strerror})") from error
    if not KEY_MIN_BYTES <= len(key) <= KEY_MAX_BYTES:
        make = f"head -c 32 /dev/urandom | base64 > {path}"
        raise refusal(path, f"a key has {KEY_MIN_BYTES} to {KEY_MAX_BYTES} bytes; make one: {make}")
    return key


def client_proof(key: bytes, server_nonce: bytes, client_nonce: bytes, client: int) -> bytes:
    """What only a robot with the key can say after a greeting: HMAC-SHA256 of both nonces and its number."""
    return _proof(key, _CLIENT, server_nonce, client_nonce, client.to_bytes(2, "little"))


def server_proof(key: bytes, server_nonce: bytes, client_nonce: bytes) -> bytes:
    """What only an edge with the key can say after a hello: HMAC-SHA256 of both nonces."""
    return _proof(key, _SERVER, server_nonce, client_nonce)


def same(proof: bytes, expected: bytes) -> bool:
    """Whether a proof is the expected one, in a time that tells nothing of where they differ."""
    return hmac.compare_digest(proof, expected)


def _proof(key: bytes, *parts: bytes) -> bytes:
    return hmac.new(key, b"".join(parts), sha256).digest()


def server_tls(certificate: Path | None, key: Path | None, ca: Path | None) -> ssl.SSLContext | None:
    """TLS of an edge.

    Args:
        certificate: its certificate chain (PEM); None for no TLS.
        key: its private key; None where it is in the same file.
        ca: who signs the certificates of robots; where it is given, a robot without one is refused.

    Returns:
        The context, TLS 1.3 and later.

    Raises:
        InputError: a file that cannot be used, or a part of TLS without the certificate.
    """
    if certificate is None:
        _without_tls(("--tls-key", key), ("--tls-ca", ca), need="--tls-cert")
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    _load_certificate(context, certificate, key)
    if ca is not None:
        _load_ca(context, ca)
        context.verify_mode = ssl.CERT_REQUIRED
    return context


def client_tls(ca: Path | None, certificate: Path | None, key: Path | None) -> ssl.SSLContext | None:
    """TLS of a robot.

    Args:
        ca: who signs the edge's certificate; None for no TLS.
        certificate: the robot's certificate chain (PEM), if the edge wants one.
        key: its private key; None where it is in the same file.

    Returns:
        The context, TLS 1.3 and later, which checks the edge's name.

    Raises:
        InputError: a file that cannot be used, or a part of TLS without the authority.
    """
    if ca is None:
        _without_tls(("--tls-cert", certificate), ("--tls-key", key), need="--tls-ca")
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    _load_ca(context, ca)
    if certificate is not None:
        _load_certificate(context, certificate, key)
    elif key is not None:
        raise InputError("--tls-key belongs to --tls-cert")
    return context


def _without_tls(*given: tuple[str, Path | None], need: str) -> None:
    for option, value in given:
        if value is not None:
            raise InputError(f"{option} belongs to {need}")


def _load_certificate(context: ssl.SSLContext, certificate: Path, key: Path | None) -> None:
    _readable(certificate, *([] if key is None else [key]))
    try:
        # A key that is locked must not ask on the terminal.
        context.load_cert_chain(certificate, key, password=lambda: b"")
    except (OSError, ssl.SSLError, ValueError) as error:
        raise unreadable(certificate, "no certificate with its private key, unlocked, as PEM", error) from error


def _load_ca(context: ssl.SSLContext, ca: Path) -> None:
    _readable(ca)
    try:
        context.load_verify_locations(ca)
    except (OSError, ssl.SSLError, ValueError) as error:
        raise unreadable(ca, "no certificate of an authority as PEM", error) from error


def _readable(*paths: Path) -> None:
    for path in paths:
        try:
            path.open("rb").close()
        except OSError as error:
            raise refusal(path, f"cannot be read ({error.strerror})") from error


def is_loopback(hosts: Sequence[str]) -> bool:
    """Whether addresses can be reached from this machine alone."""
    return all(host in ("localhost", "::1") or host.startswith("127.") for host in hosts)
