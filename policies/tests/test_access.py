"""Access control: certificates and tokens in the form that the gateway's server takes."""

import os
import subprocess
import sys

import grpc
import pytest
from conftest import Client, Noisy, Stub, assert_gateway_check_passes, running

from rollout_policies import AccessError, UnguardedAddress, serve, start
from rollout_policies.access import Tokens, is_loopback, require_guarded

COLOUR_SERVO = [sys.executable, "-m", "rollout_policies.examples.colour_servo"]
TOKENS = {role: f"{role}-0123456789abcdef" for role in ("worker", "operator", "viewer")}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """An authority, a certificate for localhost, its key, and files of tokens,
    made as in docs/OPERATING.md."""
    folder = tmp_path_factory.mktemp("access")
    names = "subjectAltName=DNS:localhost,IP:127.0.0.1\nbasicConstraints=CA:FALSE\n"
    (folder / "names").write_text(names)
    key = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    for command in (
        ["req", "-x509", *key, "-keyout", "ca-key.pem", "-out", "ca.pem", "-subj", "/CN=rollout"],
        ["req", *key, "-keyout", "key.pem", "-out", "request.pem", "-subj", "/CN=localhost"],
        ["x509", "-req", "-in", "request.pem", "-CA", "ca.pem", "-CAkey", "ca-key.pem",
         "-CAcreateserial", "-days", "2", "-extfile", "names", "-out", "cert.pem"],
    ):  # fmt: skip
        subprocess.run(["openssl", *command], cwd=folder, check=True, capture_output=True)
    lines = [f"{role} {token}\n" for role, token in TOKENS.items()]
    (folder / "tokens").write_text("# who may talk\n\n" + "".join(lines))
    for role, line in zip(TOKENS, lines):
        (folder / role).write_text(line)
    for name in ("tokens", *TOKENS):
        (folder / name).chmod(0o600)
    return folder


@pytest.fixture(scope="module")
def guarded(files):
    """The address of a server on all interfaces that requires tokens and TLS."""
    command = [*COLOUR_SERVO, "--listen", "0.0.0.0:0"]
    command += ["--tls-cert", files / "cert.pem", "--tls-key", files / "key.pem"]
    with running(*command, "--token-file", files / "tokens") as (_, address):
        yield "localhost:" + address.rpartition(":")[2]


class TlsClient(Client):
    """Sends a token over TLS."""

    def __init__(self, address, ca, token=None):
        credentials = grpc.ssl_channel_credentials(ca.read_bytes())
        if token is not None:
            token_credentials = grpc.access_token_call_credentials(token)
            credentials = grpc.composite_channel_credentials(credentials, token_credentials)
        self.channel = grpc.secure_channel(address, credentials)
        self.stub = Stub(self.channel)


@pytest.mark.parametrize("role", ["worker", "operator"])
def test_worker_and_operator_tokens_are_accepted_over_tls(files, guarded, role):
    client = TlsClient(guarded, files / "ca.pem", TOKENS[role])
    assert client.describe().name == "colour-servo"
    client.reset()
    client.channel.close()


@pytest.mark.parametrize(
    ("token", "code", "expected"),
    [
        (None, grpc.StatusCode.UNAUTHENTICATED, "name a --token-file"),
        ("worker-0123456789abcdeF", grpc.StatusCode.UNAUTHENTICATED, "does not know the token"),
        (TOKENS["viewer"], grpc.StatusCode.PERMISSION_DENIED, "token of a viewer"),
    ],
)
def test_missing_and_wrong_tokens_are_refused(files, guarded, token, code, expected):
    client = TlsClient(guarded, files / "ca.pem", token)
    for call in (client.describe, client.reset, client.infer, client.end):
        with pytest.raises(grpc.RpcError) as caught:
            call()
        assert caught.value.code() == code and expected in caught.value.details()
    # The health service needs no token.
    check = client.channel.unary_unary("/grpc.health.v1.Health/Check")
    assert check(b"") == b"\x08\x01"
    for malformed in (b"\x0a", b"\x0a\x02x", b"\x12\x00"):
        with pytest.raises(grpc.RpcError) as caught:
            check(malformed)
        assert caught.value.code() == grpc.StatusCode.INVALID_ARGUMENT
    client.channel.close()


def test_a_configured_gateway_queries_a_server_with_tls_and_tokens(files, guarded, program):
    (files / "gateway.toml").write_text(
        f'[policy.servo]\nreplicas = ["https://{guarded}"]\nca = "ca.pem"\ntoken_file = "worker"\n'
    )
    command = [program, "--listen", "127.0.0.1:0", "--config", "gateway.toml"]
    with running(*command, cwd=files) as (_, address):
        client = Client(address)
        assert client.describe(policy="servo").name == "colour-servo"
        client.channel.close()


def test_the_gateways_check_works_with_tls_and_tokens(files, guarded):
    arguments = [f"https://{guarded}", "--ca", str(files / "ca.pem")]
    assert_gateway_check_passes(*arguments, "--token-file", str(files / "operator"))
    for refused in ([], ["--token-file", str(files / "viewer")]):
        with pytest.raises(AssertionError, match="token"):
            assert_gateway_check_passes(*arguments, *refused)


@pytest.mark.parametrize(
    ("encrypted", "tokens", "expected"),
    [
        (False, False, "every client would be admitted, in the clear"),
        (False, True, "tokens would be sent in the clear"),
        (True, False, "without a token"),
        (True, True, None),
    ],
)
def test_only_loopback_addresses_need_no_tls_and_tokens(encrypted, tokens, expected):
    parsed_tokens = Tokens.parse("worker 0123456789abcdef", "the test") if tokens else None
    for loopback in ("127.0.0.1:1", "localhost:0", "[::1]:1", "[::ffff:127.0.0.1]:1"):
        require_guarded(loopback, encrypted, parsed_tokens)
    for reachable in ("0.0.0.0:1", "[::]:1", "10.0.0.7:1", ":5000"):
        if expected is None:
            require_guarded(reachable, encrypted, parsed_tokens)
            continue
        with pytest.raises(UnguardedAddress, match=expected) as caught:
            require_guarded(reachable, encrypted, parsed_tokens)
        for word in (reachable, "--tls-cert", "--insecure"):
            assert word in str(caught.value)
    assert is_loopback("127.9.9.9") and not is_loopback("")


def test_serving_other_machines_without_tls_and_tokens_is_refused():
    with pytest.raises(UnguardedAddress):
        serve(Noisy(), "0.0.0.0:0")
    with pytest.raises(UnguardedAddress):
        start(Noisy(), "0.0.0.0:0")


def test_insecure_permits_serving_other_machines():
    with running(*COLOUR_SERVO, "--listen", "0.0.0.0:0", "--insecure") as (_, address):
        client = Client("127.0.0.1:" + address.rpartition(":")[2])
        assert client.describe().name == "colour-servo"
        client.channel.close()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "find a token"),
        ("# only this", "find a token"),
        ("worker s3cret", "line 1 of the test: the token is too short"),
        ("\nboss s3cret-s3cret-s3cret", "line 2 of the test: its first word is not a role"),
        ("s3cret-s3cret-s3cret", "not two words"),
        ("worker s3cret-s3cret s3cret-s3cret", "not two words"),
        ("worker s3crét-s3cret-s3cret", "visible ASCII"),
        (f"worker {'s3cret' * 100}", "too long"),
        ("viewer 0123456789abcdef\n" * 257, "more than 256"),
    ],
)
def test_an_invalid_token_line_is_reported_by_number_without_the_token(text, expected):
    with pytest.raises(AccessError, match=expected) as caught:
        Tokens.parse(text, "the test")
    assert "s3cr" not in str(caught.value)


def test_tokens_are_not_in_their_repr(files):
    assert "0123456789" not in repr(Tokens.read(files / "tokens"))


def test_unusable_files_are_named(files, tmp_path, monkeypatch):
    large = tmp_path / "large"
    large.write_bytes(b"#" * (1 << 20))
    large.chmod(0o600)
    with pytest.raises(AccessError, match=f"{large}: it is larger than 131072 bytes"):
        Tokens.read(large)
    with pytest.raises(AccessError, match="missing: No such file"):
        Tokens.read(tmp_path / "missing")
    for name, use in (
        ("tokens", Tokens.read),
        ("key.pem", lambda key: serve(Noisy(), tls=(files / "cert.pem", key))),
    ):
        for mode in (0o644, 0o640, 0o602):
            exposed = tmp_path / f"{mode:o}-{name}"
            exposed.write_bytes((files / name).read_bytes())
            exposed.chmod(mode)
            with pytest.raises(AccessError, match=rf"{exposed}: .*{mode:04o}.*chmod 600"):
                use(exposed)
    with monkeypatch.context() as patch:
        patch.setattr(os, "geteuid", lambda: exposed.stat().st_uid + 1)
        with pytest.raises(AccessError, match="0602.*chmod o= "):
            Tokens.read(exposed)
    # The key does not match the certificate.
    with pytest.raises(AccessError, match="ca-key.pem"):
        serve(Noisy(), tls=(files / "cert.pem", files / "ca-key.pem"))
