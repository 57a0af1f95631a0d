"""The results in an archive of a campaign (`coordinator campaign archive`), without a coordinator.

The archive may come from an untrusted source. Only its rollouts are unpacked, after its list of
members has stated the size and if the disk has room for them."""

from __future__ import annotations

import gzip
import hashlib
import json
import os
import shutil
import tarfile
import tempfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pandas as pd

from . import frames
from .errors import CoordinatorError

#: The format that can be read.
FORMAT = 2
#: Largest number of bytes per read of a file.
READ_BYTES = 1 << 20
#: Longest line of a rollout, bytes.
MAX_LINE = 16 << 20
LIST, ROLLOUTS = "archive.json", "rollouts.jsonl"
#: Members that follow LIST in every archive, in this order; all later members are films.
MEMBERS = ("specification.json", "provenance.json", "report.json", ROLLOUTS)
#: Largest list of members, bytes: room for three hundred thousand films.
MAX_LIST = 64 << 20
#: Largest ratio of these members' total size to the archive's size, unless the total is below SMALL
#: bytes.
MAX_RATIO, SMALL = 100, 64 << 20


class ArchiveError(CoordinatorError, ValueError):
    """An archive is damaged or too new, or the disk has no room for it. The message names the
    file and the remedy."""


def results(file: str | os.PathLike[str]) -> pd.DataFrame:
    """Returns a row per committed rollout, sorted by rollout id and replicate; conditions are named
    as in rollout ids. Raises ArchiveError.

    `path` is the end-effector's position at rest and after each step, [steps + 1, 3], m, in the
    world frame, rounded to 0.1 mm; empty if the archive lacks it. `actions` are the robot's
    commands before the actuation axis distorts them, [steps, 7], clipped to [-1, 1] in matched
    campaigns; empty unless the campaign records transitions. Both are float32."""
    with tempfile.TemporaryDirectory(prefix="rollout-") as folder:
        path = Path(folder) / ROLLOUTS
        _unpack(Path(file), path)
        try:
            with path.open("rb") as lines:
                rows = [_row(line) for line in _lines(lines) if line["result"]]
            rows.sort(key=lambda row: (row["rollout_id"], row["replicate"]))
            return frames.frame(rows, frames.ARCHIVED)
        except (ValueError, TypeError, KeyError, RecursionError) as error:
            raise _bad(Path(file), ROLLOUTS, str(error)) from error


def _lines(file: BinaryIO) -> Iterator[dict[str, Any]]:
    """Yields the rollouts: all lines but the first, which has the campaign's state."""
    file.readline(MAX_LINE)
    while line := file.readline(MAX_LINE):
        yield json.loads(line)


def _row(line: dict[str, Any]) -> dict[str, Any]:
    manifest, committed = line["row"], line["result"]
    result = committed["measurement"]["result"]
    tenths = np.frombuffer(bytes.fromhex(committed["path"]), dtype="<i2").reshape(-1, 3)
    actions = np.frombuffer(bytes.fromhex(committed["actions"]), dtype="<f4").reshape(-1, 7)
    return {
        "rollout_id": manifest["rollout_id"],
        "replicate": line["replicate"],
        "task": f"{manifest['suite']}/{manifest['task_id']}",
        "instruction": manifest["language"],
        "axis": manifest["axis"],
        "level": manifest["level"],
        "success": result["success"],
        "steps": result["steps"],
        "wall_secs": result["wall_secs"],
        "committed_at": frames.instant(committed["committed_ms"]),
        "path": (tenths * np.float32(1e-4)).astype(np.float32),
        "actions": actions.astype(np.float32),
    }


def _unpack(file: Path, target: Path) -> None:
    """Writes an archive's rollouts to `target`; verifies the members up to them."""
    name = LIST
    try:
        with gzip.open(file, "rb") as stream:
            entry = _header(stream)
            if entry.name != LIST or not 0 <= entry.size <= MAX_LIST:
                raise _bad(file, LIST, "it is not an archive of a campaign")
            contents = json.loads(b"".join(_read(stream, entry.size)))
            members = _checked_members(file, contents, target.parent)
            for member in members:
                name, size = member["name"], member["bytes"]
                entry = _header(stream)
                if entry.name != name or not entry.isreg() or entry.size != size:
                    raise _bad(
                        file, name, f"another member is in its place, or not of {size} bytes"
                    )
                digest = hashlib.sha256()
                with target.open("wb") as out:
                    for data in _read(stream, size):
                        digest.update(data)
                        out.write(data)
                if digest.hexdigest() != member["sha256"]:
                    raise _bad(file, name, f"its SHA-256 is not the one in {LIST}")
    except FileNotFoundError as error:
        raise ArchiveError(f"failed to read archive {file}: no such file") from error
    except ArchiveError:
        raise
    except (OSError, EOFError, tarfile.TarError, zlib.error) as error:
        raise _bad(file, name, "it is truncated, damaged or of another format") from error
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise _bad(file, LIST, "it is not a list of members") from error


def _checked_members(file: Path, contents: Any, folder: Path) -> list[dict[str, Any]]:
    """Returns the members up to the rollouts. Each is written over the previous one."""
    if contents["format"] != FORMAT:
        raise ArchiveError(
            f"failed to read archive {file}: {contents.get('program')} wrote it, with format"
            f" {contents['format']}, and this package reads {FORMAT}; install the release that"
            " wrote it"
        )
    members: list[dict[str, Any]] = contents["members"][: len(MEMBERS)]
    if tuple(member["name"] for member in members) != MEMBERS:
        raise _bad(file, LIST, f"its members do not begin with {', '.join(MEMBERS)}")
    sizes = [member["bytes"] for member in members]
    compressed, free = file.stat().st_size, shutil.disk_usage(folder).free
    if min(sizes) < 0 or sum(sizes) > max(SMALL, MAX_RATIO * compressed):
        claim = f"it claims {sum(sizes) >> 20} MiB of members in {compressed >> 10} KiB of archive"
        raise _bad(file, LIST, claim)
    if max(sizes) > free:
        raise ArchiveError(
            f"failed to unpack archive {file}: it needs {max(sizes) >> 20} MiB and the disk of"
            f" {folder} has {free >> 20} MiB left; make room, or name a folder of another disk in"
            " TMPDIR"
        )
    return members


def _bad(file: Path, member: str, problem: str) -> ArchiveError:
    return ArchiveError(
        f"failed to read member {member} of archive {file}: {problem}; copy it again, or archive"
        " the campaign again with `coordinator campaign archive`"
    )


def _header(stream: gzip.GzipFile) -> tarfile.TarInfo:
    """Returns the next entry's header; the previous entry must have been read. `tarfile` itself
    would read long names and extended headers into memory, whatever size they declare."""
    return tarfile.TarInfo.frombuf(_exactly(stream, tarfile.BLOCKSIZE), "utf-8", "replace")


def _read(stream: gzip.GzipFile, size: int) -> Iterator[bytes]:
    """Yields the bytes of an entry in parts, then skips the padding of its last block."""
    remaining = size
    while remaining > 0:
        data = _exactly(stream, min(remaining, READ_BYTES))
        remaining -= len(data)
        yield data
    _exactly(stream, -size % tarfile.BLOCKSIZE)


def _exactly(stream: gzip.GzipFile, size: int) -> bytes:
    read = stream.read(size)
    if len(read) < size:
        raise EOFError
    return read
