"""``python -m rollout_libero fetch``, from a hub on this machine over real sockets."""

import hashlib
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import quote

import pytest

pytest.importorskip("rollout_libero", reason="rollout-libero is not installed")

from rollout_libero import _library, files

COMMIT = "0123456789abcdef0123456789abcdef01234567"
API = "/api/datasets/lerobot/libero-assets"
RESOLVE = f"/datasets/lerobot/libero-assets/resolve/{COMMIT}"
# The listing gives a SHA-256 of the large file, and the hub sends it from another address.
LARGE = "scenes/large texture.png"
SMALL = "scenes/room.xml"
CONTENT = {LARGE: bytes(range(251)) * 1600, SMALL: b"<mujoco/>" * 20}
PATIENCE_S = 120
"""Longest wait for a process; far more than it takes."""


class Hub(ThreadingHTTPServer):
    """Serves two files as the hub does."""

    daemon_threads = True

    def __init__(self):
        super().__init__(("127.0.0.1", 0), _Handler)
        self.seen = []
        """Requests: PATH, or PATH from BYTE."""
        self.refuses = False
        self.stalls = False
        """Sends half of the large file, and then nothing until ``released``."""
        self.released = threading.Event()
        threading.Thread(target=self.serve_forever, daemon=True).start()

    @property
    def url(self):
        return f"http://127.0.0.1:{self.server_port}"


class _Handler(BaseHTTPRequestHandler):
    def do_GET(self):  # noqa: N802 - the library's name
        hub = self.server
        begin = int(re.sub(r"\D", "", self.headers.get("Range", "0")))
        hub.seen.append(f"{self.path} from {begin}" if begin else self.path)
        if self.path == f"{API}/revision/main":
            self.send(json.dumps({"id": "x", "sha": COMMIT}).encode())
        elif self.path == f"{API}/tree/{COMMIT}?recursive=true":
            self.send(json.dumps([_entry(path) for path in CONTENT]).encode())
        elif hub.refuses:
            self.send(b"no", status=403)
        elif self.path == f"{RESOLVE}/{quote(LARGE)}":
            self.send(b"", status=302, headers={"Location": "/store/large"})
        elif self.path == "/store/large":
            self.send_file(CONTENT[LARGE], begin)
        elif self.path == f"{RESOLVE}/{SMALL}":
            self.send_file(CONTENT[SMALL], begin)
        else:
            self.send(b"", status=404)

    def send_file(self, content, begin):
        status = 206 if begin else 200
        content_range = f"bytes {begin}-{len(content) - 1}/{len(content)}"
        self.send(content[begin:], status=status, headers={"Content-Range": content_range})

    def send(self, body, status=200, headers=None):
        self.send_response(status)
        for name, value in {**(headers or {}), "Content-Length": str(len(body))}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.server.stalls and self.path == "/store/large":
            self.wfile.write(body[: len(body) // 2])
            self.wfile.flush()
            self.server.released.wait()
            self.close_connection = True
        else:
            self.wfile.write(body)

    def log_message(self, *_):
        pass


def _entry(path):
    content = CONTENT[path]
    entry = {"type": "file", "path": path, "size": len(content)}
    if path == LARGE:
        entry["lfs"] = {"oid": hashlib.sha256(content).hexdigest(), "size": len(content)}
    return entry


@pytest.fixture
def hub():
    with Hub() as hub:
        yield hub
        hub.released.set()
        hub.shutdown()


@pytest.fixture
def sources(tmp_path, monkeypatch):
    """A sources folder that has everything but assets."""
    there = files.sources()
    for name in ("libero", "robosuite"):
        (tmp_path / name).symlink_to(there / name)
    monkeypatch.setenv("ROLLOUT_SOURCES", str(tmp_path))
    for name in ("ROLLOUT_ASSETS", "HF_ENDPOINT"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path


def start(*arguments):
    return subprocess.Popen(
        [sys.executable, "-m", "rollout_libero", "fetch", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def ended(process):
    try:
        printed, said = process.communicate(timeout=PATIENCE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        raise
    return process.returncode, printed, said


def check_whole(pack):
    for path, content in CONTENT.items():
        assert (pack / path).read_bytes() == content, path
    recorded = (pack.parent / f"{pack.name}.manifest.txt").read_text().splitlines()[1:]
    assert recorded == [
        f"{hashlib.sha256(content).hexdigest()} {len(content)} {path}"
        for path, content in CONTENT.items()
    ]
    left_over = {path.name for path in pack.parent.iterdir()} - {
        pack.name,
        f"{pack.name}.manifest.txt",
    }
    assert not left_over


def test_fetched_assets_are_where_they_are_looked_for(hub, sources):
    with pytest.raises(files.MissingAssetsError, match="python -m rollout_libero fetch"):
        files.assets()
    status, printed, said = ended(start("--hub", hub.url))
    assert status == 0, said
    pack = sources / "packs" / "libero"
    check_whole(pack)
    assert files.assets() == str(pack)
    assert f"LIBERO's assets: {pack}" in printed.splitlines()
    assert "100 %" in said

    asked = len(hub.seen)
    status, printed, said = ended(start("--hub", hub.url))
    assert status == 0 and "already there" in printed and not said
    assert len(hub.seen) == asked


def test_assets_go_into_a_given_folder_from_the_hub_of_the_environment(hub, sources, monkeypatch):
    monkeypatch.setenv("HF_ENDPOINT", f"{hub.url}/")
    into = sources / "elsewhere" / "assets"
    status, printed, said = ended(start("--into", into))
    assert status == 0, said
    check_whole(into)
    assert "ROLLOUT_ASSETS" in printed and not (sources / "packs").exists()


def test_ctrl_c_ends_a_fetch_and_the_next_one_goes_on_from_there(hub, sources):
    hub.stalls = True
    process = start("--hub", hub.url)
    part = sources / "packs" / f"libero.fetching-{COMMIT[:12]}" / f"{LARGE}.part"
    deadline = time.monotonic() + PATIENCE_S
    while not (part.exists() and part.stat().st_size == len(CONTENT[LARGE]) // 2):
        assert process.poll() is None and time.monotonic() < deadline, ended(process)
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    status, _, said = ended(process)
    assert status == 130 and "goes on" in said and "Traceback" not in said, said
    # It did not wait until the hub was too slow for it.
    assert hub.seen.count("/store/large") == 1 and not hub.released.is_set()
    pack = sources / "packs" / "libero"
    assert not pack.exists()

    hub.stalls = False
    status, _, said = ended(start("--hub", hub.url))
    assert status == 0, said
    check_whole(pack)
    assert f"/store/large from {len(CONTENT[LARGE]) // 2}" in hub.seen
    assert hub.seen.count("/store/large") == 1


def test_an_interrupted_fetch_leaves_a_notebook_that_can_go_on(hub, sources):
    # The hub is in this process: it answers only while the fetch lets go of the interpreter.
    hub.stalls = True
    into = sources / "elsewhere" / "assets"

    def interrupt():
        while "/store/large" not in hub.seen:
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)

    interrupting = threading.Thread(target=interrupt)
    interrupting.start()
    with pytest.raises(KeyboardInterrupt):
        _library.native.fetch_assets(into, hub.url)
    interrupting.join()
    # What hung on the hub ends when that goes on, and with it its hold of the folder.
    hub.stalls = False
    hub.released.set()
    deadline = time.monotonic() + PATIENCE_S
    while True:
        try:
            _library.native.fetch_assets(into, hub.url)
            break
        except _library.native.FilesError as error:
            assert "under way" in str(error) and time.monotonic() < deadline
            time.sleep(0.05)
    check_whole(into)


def test_what_goes_wrong_is_said_with_a_remedy(hub, sources):
    hub.refuses = True
    status, _, said = ended(start("--hub", hub.url))
    assert status == 1 and "Traceback" not in said, said
    assert "failed to get" in said and "403" in said and "ROLLOUT_ASSETS" in said

    status, _, said = ended(start("--hub", "mirror:80"))
    assert status == 1 and "`mirror:80`: write https://HOST" in said, said

    (sources / "full").mkdir()
    status, _, said = ended(start("--hub", hub.url, "--into", sources / "full"))
    assert status == 1 and "there already; give another folder" in said, said
