"""Checkpoints and the files that they need, from folders and from the hub."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from ..catalogue import Entry, NoCheckpoint
from .upstream import UnusableCheckpoint, UnusableOption, require

#: `owner/repository`, optionally followed by a slash and a folder of the repository.
HUB_NAME = re.compile(r"(?P<repository>[\w-][\w.-]*/[\w-][\w.-]*)(?:/(?P<folder>[\w./-]+))?")
COMMIT = re.compile(r"[0-9a-f]{40}")


@dataclass(frozen=True)
class Fetched:
    """A checkpoint on this machine."""

    folder: Path
    #: Commit on the hub; empty for a local folder.
    revision: str = ""

    @property
    def settings(self) -> dict[str, str]:
        """The revision as a setting, if there is one."""
        return {"revision": self.revision} if self.revision else {}


def fetch(entry: Entry, name: str, revision: str | None = None) -> Fetched:
    """Returns the folder of a checkpoint: a local folder, or a download from the hub
    (`owner/repository` or `owner/repository/folder`).

    Raises NoCheckpoint if the name is neither a local folder nor of the hub's form, UnusableOption
    if a revision is given for a local folder, UpstreamMissing without huggingface_hub,
    UnusableCheckpoint if the hub does not provide the checkpoint."""
    local = Path(name).expanduser()
    if local.is_dir():
        if revision is not None:
            raise UnusableOption(
                f"--revision names a commit of the hub, and {name} is a folder here"
            )
        cached = local.resolve()
        is_snapshot = cached.parent.name == "snapshots" and COMMIT.fullmatch(cached.name)
        return Fetched(local, cached.name if is_snapshot else "")
    hub_name = HUB_NAME.fullmatch(name)
    if hub_name is None:
        raise NoCheckpoint(
            f"{entry.title}'s weights: there is no folder {name}, and this is not a name on the hub"
            " (owner/repository); name the weights with --checkpoint"
        )
    repository, folder = hub_name["repository"], hub_name["folder"]
    hub = require("huggingface_hub", entry)
    filters = {} if folder is None else {"allow_patterns": [f"{folder}/*", f"*/{folder}/*"]}
    try:
        snapshot = Path(hub.snapshot_download(repository, revision=revision, **filters))
    except (OSError, ValueError) as error:
        raise UnusableCheckpoint(
            f"{entry.title}'s weights: there is no folder {name} here, and the hub did not provide"
            f" {repository}{f' at {revision}' if revision else ''}: {first_line(error)}."
            f" {downloads(entry.downloads)}"
        ) from error
    commit = snapshot.name if COMMIT.fullmatch(snapshot.name) else ""
    return Fetched(_subfolder(snapshot, folder, name), commit)


def _subfolder(snapshot: Path, folder: str | None, name: str) -> Path:
    """Returns the only folder in a snapshot whose path ends in `folder`; the snapshot itself if
    `folder` is None."""
    if folder is None:
        return snapshot
    parts = Path(folder).parts
    matching = [path for path in snapshot.rglob(parts[-1]) if path.parts[-len(parts) :] == parts]
    matching = [path for path in matching if path.is_dir()]
    if len(matching) != 1:
        top = sorted(path.name for path in snapshot.iterdir() if path.is_dir())
        found = f"{len(matching)} folders" if matching else "no folder"
        raise UnusableCheckpoint(
            f"checkpoint {name}: its repository has {found} named {folder};"
            f" its top folders are {', '.join(top) or 'none'}"
        )
    return matching[0]


@contextlib.contextmanager
def naming_downloads(needed: Mapping[str, str]) -> Iterator[None]:
    """Converts an OSError, which packages raise if they cannot download a file, into
    UnusableCheckpoint, whose message lists the downloads besides the checkpoint."""
    try:
        yield
    except OSError as error:
        raise UnusableCheckpoint(f"{first_line(error)}. {downloads(needed)}") from error


def downloads(needed: Mapping[str, str]) -> str:
    """Returns a sentence that lists the downloads besides the checkpoint and
    explains how to serve without a network."""
    cached = (
        "Without a network, download everything beforehand (`hf download NAME`) and set"
        " HF_HUB_OFFLINE=1"
    )
    if not needed:
        return f"Nothing else is downloaded. {cached}"
    listed = "; ".join(f"{name} ({text})" for name, text in needed.items())
    return f"Downloads besides the checkpoint: {listed}. {cached}"


def first_line(error: BaseException) -> str:
    """Returns the first non-empty line of an error's text without final periods, or the error's
    type if there is none."""
    lines: Iterable[str] = (line.strip() for line in str(error).splitlines())
    return next((line.rstrip(".") for line in lines if line), type(error).__name__)
