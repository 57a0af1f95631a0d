"""An archive of a campaign (`coordinator campaign archive`), read without a coordinator."""

from __future__ import annotations

import hashlib
import json
import os
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

#: The newest form and schema that are read here.
FORMAT, SCHEMA = 1, 7

#: Bytes that are read at a time.
PIECE = 1 << 20

LIST, DATABASE = "archive.json", "coordinator.sqlite"

RESULTS = """
    SELECT j.rollout_id, j.replicate, j.task, j.manifest_row, r.success, r.steps, r.wall_secs,
        r.committed_ms, m.path, m.actions, a.path
    FROM result r JOIN job j ON j.id = r.job_id LEFT JOIN motion m ON m.job_id = j.id
    LEFT JOIN artifact a ON a.attempt_id = r.attempt_id AND a.kind = 'video'
    ORDER BY j.rollout_id, j.replicate
"""


class ArchiveError(CoordinatorError, ValueError):
    """A file is no archive, or not a whole one. The message names file, member and remedy."""


@dataclass(frozen=True)
class Rollout:
    """A committed rollout of an archive."""

    rollout_id: str
    replicate: int
    #: `libero_object/0`.
    task: str
    #: The instruction that the policy was given.
    instruction: str
    #: The condition, as in rollout ids: `clean`, `camera`, `combination`.
    axis: str
    #: `L0` of nominal rollouts.
    level: str
    success: bool
    #: The policy's control steps.
    steps: int
    wall_secs: float
    #: Milliseconds since the Unix epoch.
    committed_ms: int
    #: Where the end-effector was at rest and after each step: steps + 1 rows of x, y, z in the
    #: world frame, metres, to a tenth of a millimetre; float32. Empty where it was not kept.
    path: np.ndarray[Any, np.dtype[np.float32]]
    #: The policy's actions, steps rows of seven numbers, clipped into [-1, 1] in matched
    #: campaigns; float32. Empty unless the campaign records transitions.
    actions: np.ndarray[Any, np.dtype[np.float32]]
    #: Its film, a picture at rest and one after each step; None where there is none.
    film: Path | None


class Archive:
    """A campaign in one file. To be used in a `with` statement: what is unpacked is removed
    when it ends. Every member's size and SHA-256 is verified first. Raises ArchiveError.
    """

    def __init__(self, file: str | os.PathLike[str]) -> None:
        self._file = Path(file)
        self._folder = tempfile.TemporaryDirectory(prefix="rollout-")
        try:
            self._contents = self._unpack(Path(self._folder.name))
        except BaseException:
            self._folder.cleanup()
            raise

    def __enter__(self) -> Archive:
        return self

    def __exit__(self, *_error: object) -> None:
        self._folder.cleanup()

    @property
    def name(self) -> str:
        """What the campaign is called."""
        name: str = self._contents["campaign"]
        return name

    @property
    def contents(self) -> dict[str, Any]:
        """What the archive says of itself."""
        return self._contents

    def specification(self) -> dict[str, Any]:
        """The campaign's specification."""
        return self._json("specification.json")

    def report(self) -> dict[str, Any]:
        """Its report, as `coordinator report --json` prints it."""
        return self._json("report.json")

    def rollouts(self) -> Iterator[Rollout]:
        """Its committed rollouts, by rollout id and replicate."""
        folder = Path(self._folder.name)
        database = sqlite3.connect(folder / DATABASE)
        try:
            for row in database.execute(RESULTS):
                yield _rollout(row, folder)
        except sqlite3.Error as error:
            raise ArchiveError(
                f"failed to read {DATABASE} of archive {self._file}: {error}; archive the campaign"
                " again"
            ) from error
        finally:
            database.close()

    def _json(self, member: str) -> dict[str, Any]:
        text = (Path(self._folder.name) / member).read_text(encoding="utf-8")
        read: dict[str, Any] = json.loads(text)
        return read

    def _unpack(self, folder: Path) -> dict[str, Any]:
        name = LIST
        try:
            with tarfile.open(self._file, "r:gz") as tar:
                listed = tar.next()
                file = tar.extractfile(listed) if listed and listed.name == LIST else None
                if file is None:
                    raise self._bad("it is no archive of a campaign", LIST)
                contents: dict[str, Any] = json.load(file)
                self._check_version(contents)
                for member in contents["members"]:
                    name = member["name"]
                    self._member(tar, member, folder)
                name = "its end"
                if tar.next() is not None:
                    raise self._bad(f"there are members that {LIST} does not name", name)
        except FileNotFoundError as error:
            raise ArchiveError(f"failed to read archive {self._file}: it is not there") from error
        except (OSError, EOFError, tarfile.TarError, zlib.error) as error:
            raise self._bad("it is cut off, damaged or something else", name) from error
        except (ValueError, KeyError, TypeError) as error:
            if isinstance(error, ArchiveError):
                raise
            raise self._bad("it is no list of members", LIST) from error
        return contents

    def _check_version(self, contents: dict[str, Any]) -> None:
        for what, found, known in (
            ("form", contents["format"], FORMAT),
            ("schema", contents["schema"], SCHEMA),
        ):
            if found > known:
                raise ArchiveError(
                    f"failed to read archive {self._file}: {contents.get('program')} wrote it, with"
                    f" {what} {found}, and this package knows up to {known}; install a release as"
                    " new as that one"
                )

    def _member(self, tar: tarfile.TarFile, member: dict[str, Any], folder: Path) -> None:
        name, parts = member["name"], Path(member["name"]).parts
        entry = tar.next()
        if entry is None or entry.name != name or not entry.isreg() or ".." in parts:
            raise self._bad("another one is in its place, or none", name)
        target = folder.joinpath(*parts)
        if Path(name).is_absolute() or folder not in target.parents:
            raise self._bad("it leads out of the archive", name)
        target.parent.mkdir(parents=True, exist_ok=True)
        digest, size = hashlib.sha256(), 0
        source = tar.extractfile(entry)
        assert source is not None, "a regular file"
        with target.open("wb") as out:
            while piece := source.read(PIECE):
                digest.update(piece)
                size += len(piece)
                out.write(piece)
        if (size, digest.hexdigest()) != (member["bytes"], member["sha256"]):
            raise self._bad(f"it is not what {LIST} says", name)

    def _bad(self, problem: str, member: str) -> ArchiveError:
        return ArchiveError(
            f"failed to read member {member} of archive {self._file}: {problem}; copy it again, or"
            " archive the campaign again with `coordinator campaign archive`"
        )


def _rollout(row: tuple[Any, ...], folder: Path) -> Rollout:
    rollout_id, replicate, task, manifest_row, success, steps, wall_secs, committed_ms = row[:8]
    path, actions, film = row[8:]
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
        film=folder / film if film else None,
    )
