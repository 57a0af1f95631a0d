"""An archive of a campaign (`coordinator campaign archive`), read without a coordinator.

The archive may come from an untrusted source. Before anything is written, its list of members must
state the total size, and the disk must have room for it. Only tables of the database are read."""

from __future__ import annotations

import gzip
import hashlib
import json
import os
import re
import shutil
import sqlite3
import tarfile
import tempfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .errors import CoordinatorError

#: The format and schema that can be read.
FORMAT, SCHEMA = 1, 1

#: Largest number of bytes per read of a file.
READ_BYTES = 1 << 20

LIST, DATABASE = "archive.json", "coordinator.sqlite"
#: Place that an error names if it is about bytes after the last member.
END = "the end"
#: Members that follow LIST in every archive, in this order; all later members are films.
MEMBERS = ("specification.json", "provenance.json", "report.json", DATABASE)
#: File name of a film.
FILM = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]*\.mp4")

#: Largest list of members, bytes: room for three hundred thousand films.
MAX_LIST = 64 << 20
#: Largest ratio of the members' total size to the archive's size, unless the total is below SMALL
#: bytes.
MAX_RATIO, SMALL = 100, 64 << 20
#: Largest number of bytes after the tar file's end marker.
MAX_PADDING = 1 << 20

#: Tables that are read.
TABLES = ("result", "job", "motion", "artifact")

RESULTS = """
    SELECT j.rollout_id, j.replicate, j.task, j.manifest_row, r.success, r.steps, r.wall_secs,
        r.committed_ms, m.path, m.actions, a.path
    FROM result r JOIN job j ON j.id = r.job_id LEFT JOIN motion m ON m.job_id = j.id
    LEFT JOIN artifact a ON a.attempt_id = r.attempt_id AND a.kind = 'video'
    ORDER BY j.rollout_id, j.replicate
"""


class ArchiveError(CoordinatorError, ValueError):
    """An archive is damaged or too new, or the disk has no room for it. The message names the
    file and the remedy."""


@dataclass(frozen=True)
class Rollout:
    """A committed rollout of an archive."""

    rollout_id: str
    replicate: int
    #: Task, such as `libero_object/0`.
    task: str
    #: The instruction for the policy.
    instruction: str
    #: Condition, as in rollout ids: `clean` (nominal), axes such as `camera` or `camera+robot`,
    #: `combination` (all axes of the campaign), or `variant` (LIBERO's family or a suite file).
    axis: str
    #: Level: `L0` for nominal rollouts, variants, and rollouts of the placebo level.
    level: str
    success: bool
    #: Number of the policy's control steps.
    steps: int
    wall_secs: float
    #: Time of the commit, milliseconds since the Unix epoch.
    committed_ms: int
    #: Position of the end-effector at rest and after each step: steps + 1 rows of x, y, z, m, in
    #: the world frame, rounded to 0.1 mm; float32. Empty if the archive lacks it.
    path: np.ndarray[Any, np.dtype[np.float32]]
    #: The robot's commands, before the actuation axis distorts them: seven numbers per step,
    #: clipped to [-1, 1] in matched campaigns; float32. Empty unless the campaign records
    #: transitions.
    actions: np.ndarray[Any, np.dtype[np.float32]]
    #: Film with a picture at rest and one after each step; None if there is no film.
    film: Path | None


class Archive:
    """A campaign in one file. Use it in a `with` statement, which removes the unpacked files at its
    end. The size and SHA-256 of every member are verified first. Raises ArchiveError."""

    def __init__(self, file: str | os.PathLike[str]) -> None:
        self._file = Path(file)
        self._folder = tempfile.TemporaryDirectory(prefix="rollout-")
        try:
            self._contents = self._unpack(Path(self._folder.name))
            members = [member["name"] for member in self._contents["members"]]
            self._films = frozenset(members[len(MEMBERS) :])
        except BaseException:
            self._folder.cleanup()
            raise

    def __enter__(self) -> Archive:
        return self

    def __exit__(self, *_error: object) -> None:
        self._folder.cleanup()

    @property
    def name(self) -> str:
        """Name of the campaign."""
        name: str = self._contents["campaign"]
        return name

    @property
    def contents(self) -> dict[str, Any]:
        """The archive's own list of its contents."""
        return self._contents

    def specification(self) -> dict[str, Any]:
        """The campaign's specification."""
        return self._json("specification.json")

    def report(self) -> dict[str, Any]:
        """The campaign's report, as `coordinator report --json` prints it."""
        return self._json("report.json")

    def rollouts(self) -> Iterator[Rollout]:
        """The campaign's committed rollouts, by rollout id and replicate."""
        path = Path(self._folder.name) / DATABASE
        database = sqlite3.connect(f"{path.as_uri()}?mode=ro&immutable=1", uri=True)
        try:
            database.execute("PRAGMA trusted_schema = OFF")
            database.set_authorizer(_tables_only)
            for row in database.execute(RESULTS):
                yield self._rollout(row)
        except sqlite3.Error as error:
            raise self._unreadable(error) from error
        finally:
            database.close()

    def _rollout(self, row: tuple[Any, ...]) -> Rollout:
        try:
            return _rollout(row, self._film(row[-1]))
        except (ValueError, TypeError, KeyError, RecursionError) as error:
            if isinstance(error, ArchiveError):
                raise
            raise self._unreadable(error) from error

    def _film(self, path: str | None) -> Path | None:
        """Returns the path of an unpacked film. Only members of the archive are accepted, because a
        malicious database could name another file, which an export would then copy."""
        if path is None:
            return None
        if path not in self._films:
            raise ArchiveError(
                f"failed to read {DATABASE} of archive {self._file}: it names film {path!r}, which"
                " is not in the archive; archive the campaign again"
            )
        return Path(self._folder.name) / path

    def _unreadable(self, error: Exception) -> ArchiveError:
        return ArchiveError(
            f"failed to read {DATABASE} of archive {self._file}: {error}; archive the campaign"
            " again"
        )

    def _json(self, member: str) -> dict[str, Any]:
        path = Path(self._folder.name) / member
        try:
            read = json.loads(path.read_text(encoding="utf-8"))
        except (ValueError, RecursionError):
            read = None
        if not isinstance(read, dict):
            raise self._bad("it is not a JSON object", member)
        return read

    def _unpack(self, folder: Path) -> dict[str, Any]:
        name = LIST
        try:
            with gzip.open(self._file, "rb") as stream:
                entries = _Entries(stream)
                first = entries.next()
                if first is None or first.name != LIST or not 0 <= first.size <= MAX_LIST:
                    raise self._bad("it is not an archive of a campaign", LIST)
                contents: dict[str, Any] = json.loads(b"".join(entries.read(first.size)))
                self._check_version(contents)
                self._check_members(contents, folder)
                for member in contents["members"]:
                    name = member["name"]
                    self._unpack_member(entries, member, folder)
                name = END
                if entries.next() is not None:
                    raise self._bad(f"there are members that {LIST} does not name", name)
                if len(stream.read(MAX_PADDING + 1)) > MAX_PADDING:
                    raise self._bad("there are data after its last member", name)
        except FileNotFoundError as error:
            raise ArchiveError(f"failed to read archive {self._file}: no such file") from error
        except (OSError, EOFError, tarfile.TarError, zlib.error) as error:
            raise self._bad("it is truncated, damaged or of another format", name) from error
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            if isinstance(error, ArchiveError):
                raise
            raise self._bad("it is not a list of members", LIST) from error
        return contents

    def _check_version(self, contents: dict[str, Any]) -> None:
        for kind, version, known in (
            ("format", contents["format"], FORMAT),
            ("schema", contents["schema"], SCHEMA),
        ):
            if version != known:
                raise ArchiveError(
                    f"failed to read archive {self._file}: {contents.get('program')} wrote it, with"
                    f" {kind} {version}, and this package reads {kind} {known} only; install the"
                    " release that wrote it"
                )

    def _check_members(self, contents: dict[str, Any], folder: Path) -> None:
        """Checks that every member is written inside the folder, and that the disk has room for all
        members."""
        members = contents["members"]
        names = [member["name"] for member in members]
        if tuple(names[: len(MEMBERS)]) != MEMBERS:
            raise self._bad(f"its members do not begin with {', '.join(MEMBERS)}", LIST)
        films = f"artifacts/{contents['campaign']}/"
        is_folder_name = re.fullmatch(r"[A-Za-z0-9_-][A-Za-z0-9._-]*", contents["campaign"])
        for name in names[len(MEMBERS) :]:
            if (
                not is_folder_name
                or not name.startswith(films)
                or not FILM.fullmatch(name[len(films) :])
            ):
                raise self._bad(f"{name!r} is no film of this campaign", LIST)
        total = sum(member["bytes"] for member in members)
        compressed = self._file.stat().st_size
        has_negative = any(member["bytes"] < 0 for member in members)
        if total > max(SMALL, MAX_RATIO * compressed) or has_negative:
            raise self._bad(
                f"it claims {total >> 20} MiB of members in {compressed >> 10} KiB of archive", LIST
            )
        free = shutil.disk_usage(folder).free
        if total > free:
            raise ArchiveError(
                f"failed to unpack archive {self._file}: it needs {total >> 20} MiB and the disk"
                f" of {folder} has {free >> 20} MiB left; make room, or name a folder of another"
                " disk in TMPDIR"
            )

    def _unpack_member(self, entries: _Entries, member: dict[str, Any], folder: Path) -> None:
        name, size = member["name"], member["bytes"]
        entry = entries.next()
        entry_name = entry and entry.name
        if entry is not None and entry.type == tarfile.GNUTYPE_LONGNAME:
            # A name that is too long for a header is stored in a separate entry before the header.
            if not 0 <= entry.size <= len(name) + 1:
                raise self._bad("another member is in its place, or none", name)
            long_name = b"".join(entries.read(entry.size)).rstrip(b"\0")
            entry_name = long_name.decode("utf-8", "replace")
            entry = entries.next()
        if entry is None or entry_name != name or not entry.isreg():
            raise self._bad("another member is in its place, or none", name)
        if entry.size != size:
            raise self._bad(f"it has {entry.size} bytes, and {LIST} states {size}", name)
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        digest = hashlib.sha256()
        with target.open("xb") as out:
            for data in entries.read(size):
                digest.update(data)
                out.write(data)
        if digest.hexdigest() != member["sha256"]:
            raise self._bad(f"its SHA-256 is not the one in {LIST}", name)

    def _bad(self, problem: str, member: str) -> ArchiveError:
        place = member if member == END else f"member {member}"
        return ArchiveError(
            f"failed to read {place} of archive {self._file}: {problem}; copy it again, or"
            " archive the campaign again with `coordinator campaign archive`"
        )


class _Entries:
    """Reader of a tar file, entry by entry. `tarfile` itself would read long names and extended
    headers into memory, whatever size they declare."""

    def __init__(self, stream: gzip.GzipFile) -> None:
        self._stream = stream

    def next(self) -> tarfile.TarInfo | None:
        """Returns the next entry's header; None at the end. The bytes of the previous entry must
        have been read."""
        try:
            return tarfile.TarInfo.frombuf(
                self._read_exactly(tarfile.BLOCKSIZE), "utf-8", "replace"
            )
        except tarfile.HeaderError as error:
            if type(error).__name__ == "EOFHeaderError":
                return None
            raise

    def read(self, size: int) -> Iterator[bytes]:
        """Yields the bytes of an entry in parts, then skips the padding of its last block."""
        remaining = size
        while remaining > 0:
            data = self._read_exactly(min(remaining, READ_BYTES))
            remaining -= len(data)
            yield data
        self._read_exactly(-size % tarfile.BLOCKSIZE)

    def _read_exactly(self, size: int) -> bytes:
        read = self._stream.read(size)
        if len(read) < size:
            raise EOFError
        return read


def _tables_only(
    action: int, table: str | None, _column: str | None, _database: str | None, view: str | None
) -> int:
    """Permits SQLite to read the tables in TABLES only. If a table were replaced by a view or had a
    generated column, SQLite would evaluate expressions that the archive's author wrote."""
    is_table_read = action == sqlite3.SQLITE_READ and table in TABLES and view is None
    is_allowed = action == sqlite3.SQLITE_SELECT or is_table_read
    return sqlite3.SQLITE_OK if is_allowed else sqlite3.SQLITE_DENY


def _rollout(row: tuple[Any, ...], film: Path | None) -> Rollout:
    rollout_id, replicate, task, manifest_row, success, steps, wall_secs, committed_ms = row[:8]
    path, actions = row[8:10]
    manifest = json.loads(manifest_row)
    tenths = np.frombuffer(path or b"", dtype="<i2").reshape(-1, 3)
    return Rollout(
        rollout_id=rollout_id,
        replicate=replicate,
        task=task,
        instruction=manifest["language"],
        axis=manifest["axis"],
        level=manifest["level"],
        success=bool(success),
        steps=steps,
        wall_secs=wall_secs,
        committed_ms=committed_ms,
        path=(tenths * np.float32(1e-4)).astype(np.float32),
        actions=np.frombuffer(actions or b"", dtype="<f4").reshape(-1, 7).astype(np.float32),
        film=film,
    )
