"""Malformed files of initial states are refused."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from libero.libero.benchmark.init_states import load_init_states


def test_a_file_of_initial_states_cannot_run_code(tmp_path: Path) -> None:
    class MaliciousPickle:
        def __reduce__(self) -> Any:
            return os.mkdir, (str(tmp_path / "ran"),)

    file = tmp_path / "task.pruned_init"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("archive/data.pkl", pickle.dumps(MaliciousPickle()))
    with pytest.raises(ValueError, match="fetch the file again"):
        load_init_states(file)
    assert not (tmp_path / "ran").exists()
    file.write_text("<html>")
    with pytest.raises(ValueError, match="holds no initial states"):
        load_init_states(file)


class PickledCall:
    """An object that is pickled as a call of a NumPy function, with a state for its result."""

    def __init__(self, *reduction: Any) -> None:
        self.reduction = reduction

    def __reduce__(self) -> Any:
        return self.reduction


@pytest.mark.parametrize(
    "pickled",
    [
        # The bytes of this array would be read as pointers to objects.
        PickledCall(np.ndarray, ((1,), "O", b"AAAAAAAA")),
        PickledCall(np.ndarray, ((1 << 36,),)),
        PickledCall(np.dtype, ("V8", False, True), (3, "<", None, None, None, 1 << 30, 1, 0)),
        np.zeros((2, 3), "i4"),
        np.zeros((1, 2, 3)),
        np.array([[None]]),
        [1, 2],
    ],
)
def test_a_file_of_initial_states_gives_only_a_table_of_numbers(
    tmp_path: Path, pickled: Any
) -> None:
    with pytest.raises(ValueError, match="holds no initial states"):
        read_states(tmp_path, pickle.dumps(pickled, protocol=2))
    table = np.arange(6.0).reshape(2, 3)
    for states in (table, np.asfortranarray(table), table[0]):
        loaded = read_states(tmp_path, pickle.dumps(states, protocol=2))
        assert loaded.dtype == np.float64 and loaded.flags.writeable
        assert np.array_equal(loaded, states)


def test_a_file_of_initial_states_that_is_too_large_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="larger than 64 MiB"):
        read_states(tmp_path, bytes((64 << 20) + 1))


#: Reads a file with at most 256 MiB more memory than at the start, and prints the error's class and
#: text.
READS_WITH_LITTLE_MEMORY = """
import resource, sys
from libero.libero.benchmark.init_states import load_init_states
pages = int(open("/proc/self/statm").read().split()[0])
most = pages * resource.getpagesize() + (256 << 20)
resource.setrlimit(resource.RLIMIT_AS, (most, most))
try:
    load_init_states(sys.argv[1])
except Exception as error:
    print(type(error).__name__, error, repr(error.__cause__))
"""


@pytest.mark.parametrize("bomb", ["bzip2", "memo", "operations", "texts"])
def test_a_file_of_initial_states_with_a_bomb_takes_little_memory(
    tmp_path: Path, bomb: str
) -> None:
    file = tmp_path / "task.pruned_init"
    reason = "its pickle has more than 256 operations"
    method, content = zipfile.ZIP_DEFLATED, b"\x80\x02" + b"N0" * 10_000_000 + b"N."
    if bomb == "bzip2":
        method, content = zipfile.ZIP_BZIP2, bytes(300_000_000)
        reason = "its pickle is neither stored nor deflated"
    elif bomb == "memo":
        content = b"\x80\x02Nr" + (1 << 26).to_bytes(4, "little") + b"."
        reason = "its pickle uses memo entry 67108864 of 256"
    elif bomb == "texts":
        # A text of 8 MB is encoded to bytes eighty times.
        text = b"X" + (8_000_000).to_bytes(4, "little") + b"a" * 8_000_000
        call = b"c_codecs\nencode\nq\x00" + text + b"X\x06\x00\x00\x00latin1\x86q\x01R"
        content = b"\x80\x02(" + call + b"h\x00h\x01R" * 80 + b"l."
        reason = "its pickle is no array"
    with zipfile.ZipFile(file, "w", method) as archive:
        archive.writestr("archive/data.pkl", content)
    del content
    reading = subprocess.run(
        [sys.executable, "-c", READS_WITH_LITTLE_MEMORY, file],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    assert reading.stdout.startswith("ValueError"), reading.stdout
    assert reason in reading.stdout, reading.stdout


def read_states(folder: Path, content: bytes) -> Any:
    """Writes a file whose pickle has this content, and reads its initial states."""
    file = folder / "task.pruned_init"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("archive/data.pkl", content)
    return load_init_states(file)
