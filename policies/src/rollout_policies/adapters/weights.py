"""Whether a network holds the numbers that its files of weights hold.

Loaders of weights are lenient: some skip what does not fit, some print a warning
and go on. What they leave out stays random, and such a policy moves, fails every
task and looks merely bad. So every tensor is compared after loading, both ways:
by name, shape and content.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from .upstream import UnusableCheckpoint

#: Numbers that are read from a file at a time, or one row if that is longer.
PIECE = 1 << 24
#: Names shown of every kind of difference.
SHOWN = 3
#: Tensors that networks compute when they are made, and that older versions of
#: transformers wrote into files all the same.
COMPUTED = ("*.rotary_emb.inv_freq", "*.position_ids")


@dataclass(frozen=True)
class Exceptions:
    """Differences that are right for a policy, by name.

    Patterns are those of a shell: `*` stands for anything.
    """

    #: Two names of one tensor, of which a file may hold one only.
    tied: Mapping[str, str] = field(default_factory=dict)
    #: Of the network, but never used to act: a file may lack them.
    unused: tuple[str, ...] = ()
    #: Of the file, and not of the network: computed there, or for training only.
    skipped: tuple[str, ...] = COMPUTED

    def partner(self, name: str) -> str | None:
        """The other name of a tied tensor."""
        both = {**self.tied, **{second: first for first, second in self.tied.items()}}
        return both.get(name)


@dataclass
class Differences:
    """Names of tensors, by what is wrong with them."""

    missing: list[str] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)
    shape: list[str] = field(default_factory=list)
    content: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        kinds = {
            "missing in the file": self.missing,
            "unknown to the network": self.unknown,
            "of another shape": self.shape,
            "of other content": self.content,
        }
        return "; ".join(
            f"{len(names)} {kind} ({', '.join(names[:SHOWN])}{', ...' * (len(names) > SHOWN)})"
            for kind, names in kinds.items()
            if names
        )


def compare(
    network: Mapping[str, Any],
    stored: Mapping[str, Any],
    same: Callable[[Any, Any], bool],
    exceptions: Exceptions = Exceptions(),
) -> Differences:
    """What differs between a network's tensors and the stored ones, by name.

    Both sides have a `shape`; `same` says whether two of one shape have the same
    content, and is asked about every pair.
    """
    found = Differences()

    def look(name: str, mine: Any, theirs: Any) -> None:
        if tuple(mine.shape) != tuple(theirs.shape):
            found.shape.append(f"{name}: {list(mine.shape)}, in the file {list(theirs.shape)}")
        elif not same(mine, theirs):
            found.content.append(name)

    for name, mine in network.items():
        partner = exceptions.partner(name)
        if name in stored:
            look(name, mine, stored[name])
        elif any(fnmatchcase(name, pattern) for pattern in exceptions.unused):
            continue
        elif partner in stored:
            look(name, mine, stored[partner])
        else:
            found.missing.append(name)
    for name, theirs in stored.items():
        partner = exceptions.partner(name)
        if name in network or any(fnmatchcase(name, p) for p in exceptions.skipped):
            continue
        if partner in network:
            look(name, network[partner], theirs)
        else:
            found.unknown.append(name)
    return found


def require_loaded(
    network: Any,
    stored: Mapping[str, Any],
    checkpoint: str,
    exceptions: Exceptions = Exceptions(),
    part: str = "the network",
) -> None:
    """Compares a torch module with what was stored of it: torch's tensors, or
    those of `stored_in`.

    Raises UnusableCheckpoint, which names what differs.
    """
    found = compare(network.state_dict(), stored, _same, exceptions)
    if differences := str(found):
        raise UnusableCheckpoint(
            f"checkpoint {checkpoint} was not loaded as it is stored: of {part}, {differences}."
            " What was not loaded is random. Install the version of the policy's package"
            " that wrote the checkpoint, or write the checkpoint again with this one"
        )


def load_stored(
    network: Any, tensors: Mapping[str, Any], checkpoint: str, part: str = "the network"
) -> None:
    """Puts torch's tensors into a torch module, all of them and nothing else.

    Raises UnusableCheckpoint, which names what does not fit.
    """
    # It copies what fits before it complains; the comparison says it better.
    with contextlib.suppress(RuntimeError):
        network.load_state_dict(tensors)
    require_loaded(network, tensors, checkpoint, part=part)


@contextlib.contextmanager
def stored_in(
    files: Iterable[Path], rename: Callable[[str], str] = lambda name: name
) -> Iterator[dict[str, Any]]:
    """The tensors of safetensors files by name, read only when they are compared.

    `rename` gives the network's name for a file's.
    """
    from safetensors import safe_open

    with contextlib.ExitStack() as stack:
        tensors = {}
        for path in sorted(files):
            file = stack.enter_context(safe_open(str(path), framework="pt"))
            for name in file.keys():
                tensors[rename(name)] = _InFile(file, name)
        yield tensors


class _InFile:
    """A tensor of an open safetensors file, read row by row."""

    def __init__(self, file: Any, name: str) -> None:
        self._file = file
        self._name = name
        self.shape = tuple(file.get_slice(name).get_shape())

    def __getitem__(self, rows: slice) -> Any:
        return self._file.get_slice(self._name)[rows]

    def whole(self) -> Any:
        return self._file.get_tensor(self._name)


def _same(mine: Any, theirs: Any) -> bool:
    """Whether a tensor of a network is the stored one, in the network's type."""
    import torch

    if not mine.shape:
        whole = theirs.whole() if isinstance(theirs, _InFile) else theirs
        return torch.equal(whole.to(mine.device, mine.dtype), mine)
    rows = max(1, PIECE // max(1, mine[:1].numel()))
    return all(
        torch.equal(
            theirs[start : start + rows].to(mine.device, mine.dtype), mine[start : start + rows]
        )
        for start in range(0, len(mine), rows)
    )
