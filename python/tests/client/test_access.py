"""Access to a coordinator, and errors about servers that are not coordinators."""

import logging
import os
import socket
import threading

import pytest

from rollout_client import Client
from rollout_client.errors import AccessDeniedError, SettingsError, UnreachableError

from .conftest import specification

TOKENS = {"operator": "a" * 32, "viewer": "b" * 32, "worker": "c" * 32}


def token_file(folder, *lines):
    path = folder / "tokens"
    path.write_text("\n".join(lines) + "\n")
    path.chmod(0o600)
    return path


def test_a_token_file_that_others_can_read_is_refused(tmp_path):
    path = token_file(tmp_path, f"operator {TOKENS['operator']}")
    for mode in (0o644, 0o640, 0o602):
        path.chmod(mode)
        with pytest.raises(SettingsError, match=rf"{mode:04o}.*chmod 600") as refused:
            Client("http://127.0.0.1:1", token_file=path)
        assert TOKENS["operator"] not in str(refused.value)
    path.chmod(0o400)
    Client("http://127.0.0.1:1", token_file=path).close()


def test_a_token_file_of_another_user_may_be_read_by_its_group(tmp_path, monkeypatch):
    path = token_file(tmp_path, f"operator {TOKENS['operator']}")
    monkeypatch.setattr(os, "geteuid", lambda: path.stat().st_uid + 1)
    path.chmod(0o644)
    with pytest.raises(SettingsError, match="0644.*chmod o= "):
        Client("http://127.0.0.1:1", token_file=path)
    path.chmod(0o640)
    Client("http://127.0.0.1:1", token_file=path).close()


@pytest.fixture(scope="module")
def guarded(serve, certificates, tmp_path_factory):
    """Returns the URL of a coordinator with TLS and tokens."""
    lines = [f"{role} {token}" for role, token in TOKENS.items()]
    tokens = token_file(tmp_path_factory.mktemp("tokens"), *lines)
    server = serve(
        "--tls-cert", certificates / "cert.pem", "--tls-key", certificates / "key.pem",
        "--token-file", tokens,
    )  # fmt: skip
    return f"https://localhost:{server.port}"


def test_an_operator_and_the_program_use_a_coordinator_with_tls_and_tokens(
    guarded, certificates, connect, tmp_path
):
    # In a file with several roles, the client uses the operator's line.
    lines = [f"{role} {token}" for role, token in sorted(TOKENS.items(), reverse=True)]
    tokens = token_file(tmp_path, "# mine", *lines)
    client = connect(guarded, ca=certificates / "ca.pem", token_file=tokens)
    # The forecast runs the program `coordinator`; the other calls reach the coordinator directly.
    campaign = client.create(specification("guarded"))
    assert campaign.report().success["missing"].sum() == 8
    assert client.forecast(specification("more")).total == 8


def test_credentials_are_read_from_the_command_lines_environment_variables(
    guarded, certificates, connect, tmp_path, monkeypatch
):
    monkeypatch.setenv("COORDINATOR_URL", guarded)
    monkeypatch.setenv("ROLLOUT_CA", str(certificates / "ca.pem"))
    monkeypatch.setenv("ROLLOUT_TOKENS", f"viewer {TOKENS['viewer']}")
    assert connect(None).campaigns() is not None
    lines = token_file(tmp_path, f"operator {'d' * 32}")
    monkeypatch.setenv("ROLLOUT_TOKEN_FILE", str(lines))
    with pytest.raises(AccessDeniedError):
        connect(None).campaigns()


def test_the_error_for_a_refused_token_has_the_remedy(guarded, certificates, connect, tmp_path):
    ca = certificates / "ca.pem"
    with pytest.raises(AccessDeniedError, match="without a token.*token_file"):
        connect(guarded, ca=ca).campaigns()
    with pytest.raises(AccessDeniedError, match="does not know the token"):
        connect(guarded, ca=ca, token_file=token_file(tmp_path, f"viewer {'d' * 32}")).campaigns()
    viewer = token_file(tmp_path, f"viewer {TOKENS['viewer']}")
    client = connect(guarded, ca=ca, token_file=viewer)
    assert client.campaigns() is not None
    with pytest.raises(AccessDeniedError, match="operator") as denied:
        client.create(specification("mine"))
    assert TOKENS["viewer"] not in str(denied.value)
    assert TOKENS["viewer"] not in repr(client._connection.access)


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (["operator"], "line 1 .*ROLE TOKEN"),
        (["", "king 0123456789abcdef"], "line 2 .*ROLE TOKEN"),
        ([f"worker {TOKENS['worker']}"], "token of role operator or viewer"),
        (["# nothing"], "token of role operator or viewer"),
    ],
)
def test_an_unusable_token_file_is_named_with_the_line(tmp_path, lines, expected):
    with pytest.raises(SettingsError, match=expected) as refused:
        Client(token_file=token_file(tmp_path, *lines))
    assert TOKENS["worker"] not in str(refused.value)


def test_invalid_files_and_addresses_are_named(tmp_path):
    (tmp_path / "text").write_text("no certificate")
    with pytest.raises(SettingsError, match="absent"):
        Client(token_file=tmp_path / "absent")
    with pytest.raises(SettingsError, match="certificates as PEM"):
        Client(ca=tmp_path / "text")
    for url in ("keeper:7411", "ftp://keeper", "http://", "http://keeper:7411/page", "http://h:x"):
        with pytest.raises(SettingsError, match="http://HOST:PORT"):
            Client(url)


def test_a_token_is_never_sent_in_the_clear_to_another_machine(tmp_path):
    tokens = token_file(tmp_path, f"viewer {TOKENS['viewer']}")

    def sends_token(url):
        return bool(Client(url, token_file=tokens)._connection.access.metadata)

    urls = ("https://h:1", "http://127.0.0.1:1", "http://[::1]:1", "http://localhost:1")
    assert all(map(sends_token, urls))
    urls = ("http://h:1", "http://10.0.0.7:1", "http://localhost.evil:1", "grpc://h:1")
    assert not any(map(sends_token, urls))


def unreachable(client):
    """Returns the error of a client whose coordinator cannot be reached."""
    with pytest.raises(UnreachableError) as failed:
        client.campaigns()
    assert failed.value.found in str(failed.value)
    assert failed.value.remedy in str(failed.value)
    assert isinstance(failed.value, ConnectionError)
    return failed.value


def test_the_error_without_a_coordinator_has_grpcs_reason(
    connect, gateway, listening, guarded, certificates
):
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    error = unreachable(connect(f"http://127.0.0.1:{port}"))
    assert "refused" in error.found and "coordinator serve" in error.remedy
    error = unreachable(connect(f"http://{gateway.address}", retry_secs=60))
    assert "not a coordinator" in error.found
    for greeting in (b"SSH-2.0-OpenSSH_9.6\r\n", b"HTTP/1.1 502 Bad Gateway\r\n\r\n"):
        unreachable(connect(f"http://127.0.0.1:{listening(greeting)}"))
    error = unreachable(connect(guarded, ca=certificates / "other.pem"))
    assert "CERTIFICATE_VERIFY_FAILED" in error.found
    unreachable(connect(guarded.replace("https", "http")))


def test_a_waiting_client_gets_its_answer_when_the_coordinator_starts(
    serve, connect, caplog, tmp_path
):
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    client = connect(f"http://127.0.0.1:{port}", retry_secs=60)
    answers = []
    with caplog.at_level(logging.WARNING, "rollout_client"):
        waiting = threading.Thread(target=lambda: answers.append(client.campaigns()))
        waiting.start()
        while not caplog.records and waiting.is_alive():
            waiting.join(0.05)
        serve(listen=f"127.0.0.1:{port}")
        waiting.join(60)
    assert len(answers) == 1
    assert "refused" in caplog.text and "trying again for 60 s" in caplog.text
