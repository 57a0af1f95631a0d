"""Malformed files of initial states are refused."""

import itertools
import os
import pickle
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
        np.array([[np.nan]]),
        [1, 2],
        [],
    ],
)
def test_a_file_of_initial_states_gives_only_a_table_of_numbers(
    tmp_path: Path, pickled: Any
) -> None:
    with pytest.raises(ValueError, match="holds no initial states"):
        read_states(tmp_path, pickle.dumps(pickled, protocol=2))
    table = np.arange(6.0).reshape(2, 3)
    forms = (table, np.asfortranarray(table), table[0], table.astype("f4"), list(table))
    for states, protocol in itertools.product(forms, (2, 3, 4, 5)):
        loaded = read_states(tmp_path, pickle.dumps(states, protocol=protocol))
        assert loaded.dtype == np.asarray(states).dtype and loaded.flags.writeable
        assert np.array_equal(loaded, states)


#: A tensor [2, 3] of doubles with strides [1, 2], as `torch.save` writes it.
TENSOR = (
    b"\x80\x02ctorch._utils\n_rebuild_tensor_v2\n((X\x07\0\0\0storagectorch\nDoubleStorage\n"
    b"X\x01\0\0\x000X\x03\0\0\0cpuK\x06tQK\0K\x02K\x03\x86K\x01K\x02\x86\x89ccollections\nOrderedDict\n)RtR."
)


def test_tensors_are_read_without_pytorch(tmp_path: Path) -> None:
    file = tmp_path / "task.pruned_init"
    for numbers in (6, 5):
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr("a/data.pkl", TENSOR)
            archive.writestr("a/data/0", np.arange(float(numbers)).tobytes())
        if numbers == 6:
            assert np.array_equal(load_init_states(file), [[0, 2, 4], [1, 3, 5]])
        else:
            with pytest.raises(ValueError, match="out of bounds"):
                load_init_states(file)


@pytest.mark.parametrize(
    ("content", "named"),
    [
        ("", "empty"),
        ("<html>", "web page"),
        ("version https://git-lfs.github.com/spec/v1", "lfs pull"),
    ],
)
def test_other_files_are_named(tmp_path: Path, content: str, named: str) -> None:
    file = tmp_path / "task.pruned_init"
    file.write_text(content)
    with pytest.raises(ValueError, match=named):
        load_init_states(file)


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
    tmp_path: Path, bomb: str, python: Any
) -> None:
    file = tmp_path / "task.pruned_init"
    reason = "its pickle has more than 8192 operations"
    method, content = zipfile.ZIP_DEFLATED, b"\x80\x02" + b"N0" * 10_000_000 + b"N."
    if bomb == "bzip2":
        method, content = zipfile.ZIP_BZIP2, bytes(300_000_000)
        reason = "its pickle is neither stored nor deflated"
    elif bomb == "memo":
        content = b"\x80\x02Nr" + (1 << 26).to_bytes(4, "little") + b"."
        reason = "its pickle uses memo entry 67108864 of 8192"
    elif bomb == "texts":
        # A text of 8 MB is encoded to bytes eighty times.
        text = b"X" + (8_000_000).to_bytes(4, "little") + b"a" * 8_000_000
        call = b"c_codecs\nencode\nq\x00" + text + b"X\x06\x00\x00\x00latin1\x86q\x01R"
        content = b"\x80\x02(" + call + b"h\x00h\x01R" * 80 + b"l."
        reason = "its pickle is no array"
    with zipfile.ZipFile(file, "w", method) as archive:
        archive.writestr("archive/data.pkl", content)
    del content
    reading = python("-c", READS_WITH_LITTLE_MEMORY, file)
    assert reading.stdout.startswith("ValueError"), reading.stdout
    assert reason in reading.stdout, reading.stdout


def read_states(folder: Path, content: bytes) -> Any:
    """Writes a file whose pickle has this content, and reads its initial states."""
    file = folder / "task.pruned_init"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("archive/data.pkl", content)
    return load_init_states(file)
