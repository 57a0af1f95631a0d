"""Real programs for the tests: coordinators, a gateway, and a worker that runs a campaign."""

import contextlib
import os
import shutil
import socket
import subprocess
import sys
import threading
import time

import pytest

pytest.importorskip("grpc", reason="pip install grpcio protobuf pandas")
pytest.importorskip("pandas", reason="pip install grpcio protobuf pandas")

from rollout_client import Client

#: Longest wait for a program to listen, and for a campaign to finish, s.
START_SECS, CAMPAIGN_SECS = 60, 600

#: Environment variables of the user, which tests must not see.
UNSET = ("COORDINATOR_URL", "ROLLOUT_TOKENS", "ROLLOUT_TOKEN_FILE", "ROLLOUT_CA")


@pytest.fixture(autouse=True, scope="session")
def unset_variables():
    with pytest.MonkeyPatch.context() as patch:
        for name in UNSET:
            patch.delenv(name, raising=False)
        yield


class Server:
    """A listening program."""

    def __init__(self, *command):
        self.process = subprocess.Popen(
            list(map(str, command)), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        self.output = []
        self._listens = threading.Event()
        threading.Thread(target=self._read, daemon=True).start()
        if not self._listens.wait(START_SECS) or self.address is None:
            raise RuntimeError(f"{command} did not listen: {''.join(self.output)}")

    address = None

    def _read(self):
        for line in self.process.stdout:
            self.output.append(line)
            if self.address is None and "listening on " in line:
                self.address = line.split("listening on ")[1].split()[0].strip(",")
                self._listens.set()
        self._listens.set()

    @property
    def port(self):
        return int(self.address.rpartition(":")[2])

    def stop(self):
        self.process.terminate()
        self.process.wait(START_SECS)


@pytest.fixture(scope="session")
def serve(programs, tmp_path_factory):
    """Starts coordinators with the flags of `coordinator serve`, and stops them at the end."""
    with contextlib.ExitStack() as stack:

        def start(*flags, listen="127.0.0.1:0"):
            data = tmp_path_factory.mktemp("data")
            program = programs / "coordinator"
            server = Server(program, "serve", "--data", data, "--listen", listen, *flags)
            stack.callback(server.stop)
            return server

        yield start


@pytest.fixture(scope="session")
def gateway(programs):
    flags = ("--listen", "127.0.0.1:0", "--route", "expert=builtin:expert")
    server = Server(programs / "policy-gateway", *flags)
    yield server
    server.stop()


@pytest.fixture(scope="session")
def connect(programs):
    """Creates clients that do not wait for an unreachable coordinator."""
    with contextlib.ExitStack() as stack:

        def create(url, **settings):
            settings = {"retry_secs": 0, "program": programs / "coordinator", **settings}
            return stack.enter_context(Client(url, **settings))

        yield create


@pytest.fixture
def client(serve, connect):
    return connect(f"http://{serve().address}")


def specification(name, endpoint="http://127.0.0.1:1", **fields):
    """Returns a campaign of 8 rollouts: two configurations, each under four conditions."""
    return {
        "name": name,
        "policy": {"name": "expert", "endpoint": endpoint},
        "tasks": ["libero_object/0"],
        "axes": ["camera", "actuation"],
        "levels": ["L1"],
        "configs": [0, 1],
        "nominal": "eval",
        **fields,
    }


@pytest.fixture(scope="session")
def working(programs):
    """Runs a coordinator's worker during a `with` statement."""

    @contextlib.contextmanager
    def start(server):
        flags = ("--connect", f"http://{server.address}", "--slots", "2", "--assets", "primitives")
        with subprocess.Popen(
            [programs / "worker", *flags],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        ) as worker:
            try:
                yield worker
            finally:
                worker.terminate()
                worker.communicate(timeout=START_SECS)

    return start


@pytest.fixture(scope="session")
def run(working):
    """Starts a worker that runs a coordinator's campaign, and waits for the campaign's end."""

    def run_all(server, campaign):
        end = time.monotonic() + CAMPAIGN_SECS
        with working(server) as worker:
            for status in campaign.follow(every=0.5):
                if worker.poll() is not None or time.monotonic() > end:
                    printed = worker.stdout.read()
                    pytest.fail(f"the campaign did not finish: {status}; {printed}")

    return run_all


@pytest.fixture(scope="session")
def measured(serve, connect, gateway, run):
    """A client of a coordinator with the finished campaign `measured`."""
    server = serve()
    client = connect(f"http://{server.address}")
    run(server, client.create(specification("measured", f"http://{gateway.address}")))
    return client


@pytest.fixture(scope="session")
def certificates(tmp_path_factory):
    """A folder with the certificates of two authorities, `ca.pem` and `other.pem`, and with
    `cert.pem`, a certificate for localhost that `ca.pem` signed, and its key, `key.pem`. The
    commands are those of docs/OPERATING.md."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    folder = tmp_path_factory.mktemp("certificates")
    (folder / "names").write_text("subjectAltName=DNS:localhost\nbasicConstraints=CA:FALSE\n")
    for authority in ("ca", "other"):
        openssl(
            folder,
            "req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=rollout"
            f" -keyout {authority}-key.pem -out {authority}.pem",
        )
    openssl(
        folder, "req -newkey rsa:2048 -nodes -subj /CN=localhost -keyout key.pem -out request.pem"
    )
    openssl(
        folder,
        "x509 -req -in request.pem -CA ca.pem -CAkey ca-key.pem -CAcreateserial -days 1"
        " -extfile names -out cert.pem",
    )
    return folder


def openssl(folder, command):
    done = subprocess.run(["openssl", *command.split()], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.fixture
def listening():
    """Starts servers that are not coordinators: each sends `greeting` to every client and
    closes the connection. Returns the server's port."""
    with contextlib.ExitStack() as stack:

        def start(greeting):
            server = stack.enter_context(socket.create_server(("127.0.0.1", 0)))

            def answer():
                with contextlib.suppress(OSError):
                    while True:
                        connection, _ = server.accept()
                        with connection, contextlib.suppress(OSError):
                            connection.sendall(greeting)
                            connection.shutdown(socket.SHUT_WR)
                            connection.settimeout(2)
                            while connection.recv(4096):
                                pass

            threading.Thread(target=answer, daemon=True).start()
            return server.getsockname()[1]

        yield start


def in_a_process(code, *arguments, **options):
    """Starts a new Python process that runs the code and finds this process's packages."""
    return subprocess.Popen(
        [sys.executable, "-c", code, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        **options,
    )
