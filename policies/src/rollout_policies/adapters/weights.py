"""Comparison of a loaded network with its files of weights.

Loaders of weights are lenient: some skip tensors that do not fit, some only print a warning.
Skipped tensors stay random; the arm then moves but every task fails, which looks like a poor
policy. So every tensor is compared after loading, in both directions: by name, shape and
content."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from .upstream import UnusableCheckpoint

#: Numbers of a stored tensor that are read and compared at a time; at least one row.
COMPARED_NUMBERS = 1 << 24
#: Names shown for each kind of difference.
SHOWN = 3
#: Tensors that networks compute at construction, and that older versions of transformers
#: nevertheless stored.
COMPUTED = ("*.rotary_emb.inv_freq", "*.position_ids")


@dataclass(frozen=True)
class Exceptions:
    """Differences that are permitted for a policy, by name.

    Patterns have shell syntax: `*` matches anything."""

    #: Pairs of names of one tensor; a file may lack either name of a pair.
    tied: Mapping[str, str] = field(default_factory=dict)
    #: Tensors of the network that actions do not use: a file may lack them.
    unused: tuple[str, ...] = ()
    #: Tensors of the file that the network lacks: computed, or for training only.
    skipped: tuple[str, ...] = COMPUTED

    def partner(self, name: str) -> str | None:
        """Returns the name that is tied to this name, or None."""
        partners = {**self.tied, **{second: first for first, second in self.tied.items()}}
        return partners.get(name)


@dataclass
class Differences:
    """Names of tensors, grouped by fault."""

    missing: list[str] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)
    shape: list[str] = field(default_factory=list)
    content: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        kinds = {
            "missing in the file": self.missing,
            "unknown to the network": self.unknown,
            "of another shape": self.shape,
            "with other content": self.content,
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
    """Returns the differences between a network's tensors and the stored ones, by name.

    Tensors on both sides have a `shape`; `same` compares the contents of each pair of equal
    shape."""
    differences = Differences()

    def compare_pair(name: str, loaded: Any, in_file: Any) -> None:
        if tuple(loaded.shape) != tuple(in_file.shape):
            shapes = f"{list(loaded.shape)}, in the file {list(in_file.shape)}"
            differences.shape.append(f"{name}: {shapes}")
        elif not same(loaded, in_file):
            differences.content.append(name)

    for name, loaded in network.items():
        partner = exceptions.partner(name)
        if name in stored:
            compare_pair(name, loaded, stored[name])
        elif any(fnmatchcase(name, pattern) for pattern in exceptions.unused):
            continue
        elif partner in stored:
            compare_pair(name, loaded, stored[partner])
        else:
            differences.missing.append(name)
    for name, in_file in stored.items():
        partner = exceptions.partner(name)
        if name in network or any(fnmatchcase(name, p) for p in exceptions.skipped):
            continue
        if partner in network:
            compare_pair(name, network[partner], in_file)
        else:
            differences.unknown.append(name)
    return differences


def require_loaded(
    network: Any,
    stored: Mapping[str, Any],
    checkpoint: str,
    exceptions: Exceptions = Exceptions(),
    part: str = "the network",
) -> None:
    """Compares a torch module with its stored tensors, which are torch tensors or those of
    `stored_in`.

    Raises UnusableCheckpoint, which names the differences."""
    if differences := str(compare(network.state_dict(), stored, _is_equal, exceptions)):
        raise UnusableCheckpoint(
            f"checkpoint {checkpoint} was not loaded as it is stored. Tensors of {part}:"
            f" {differences}. Tensors that were not loaded are random. Install the version of the"
            " policy's package that wrote the checkpoint, or write the checkpoint again with the"
            " installed version"
        )


def load_stored(
    network: Any, tensors: Mapping[str, Any], checkpoint: str, part: str = "the network"
) -> None:
    """Copies torch's tensors into a torch module and requires an exact match.

    Raises UnusableCheckpoint, which names the tensors that do not fit."""
    # load_state_dict copies what fits before it raises; require_loaded has a better message.
    with contextlib.suppress(RuntimeError):
        network.load_state_dict(tensors)
    require_loaded(network, tensors, checkpoint, part=part)


@contextlib.contextmanager
def stored_in(
    files: Iterable[Path], rename: Callable[[str], str] = lambda name: name
) -> Iterator[dict[str, Any]]:
    """Context of the tensors of safetensors files by name, read only when they are compared.

    `rename` converts a name in the file to the network's."""
    from safetensors import safe_open

    with contextlib.ExitStack() as stack:
        tensors = {}
        for path in sorted(files):
            file = stack.enter_context(safe_open(str(path), framework="pt"))
            for name in file.keys():
                tensors[rename(name)] = _StoredTensor(file, name)
        yield tensors


class _StoredTensor:
    """A tensor of an open safetensors file, read row by row."""

    def __init__(self, file: Any, name: str) -> None:
        self._file = file
        self._name = name
        self.shape = tuple(file.get_slice(name).get_shape())

    def __getitem__(self, rows: slice) -> Any:
        return self._file.get_slice(self._name)[rows]

    def whole(self) -> Any:
        return self._file.get_tensor(self._name)


def _is_equal(loaded: Any, in_file: Any) -> bool:
    """Returns True if both tensors are equal in the data type of the loaded tensor."""
    import torch

    if not loaded.shape:
        whole = in_file.whole() if isinstance(in_file, _StoredTensor) else in_file
        return torch.equal(whole.to(loaded.device, loaded.dtype), loaded)
    rows = max(1, COMPARED_NUMBERS // max(1, loaded[:1].numel()))
    return all(
        torch.equal(
            in_file[start : start + rows].to(loaded.device, loaded.dtype),
            loaded[start : start + rows],
        )
        for start in range(0, len(loaded), rows)
    )
