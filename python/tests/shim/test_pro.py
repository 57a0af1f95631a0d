"""LIBERO-PRO's package, imported and called as RLinf does with `LIBERO_TYPE=pro`."""

from typing import Any

import pytest

#: Imports and calls LIBERO-PRO as `rlinf/envs/libero/libero_env.py` does.
AS_RLINF = """
import importlib, os, sys
import numpy as np

package = importlib.import_module("liberopro")
core = importlib.import_module("liberopro.liberopro")
bench = importlib.import_module("liberopro.liberopro.benchmark")
envs = importlib.import_module("liberopro.liberopro.envs")
sys.modules["libero"] = package
sys.modules["libero.libero"] = core
sys.modules["libero.libero.benchmark"] = bench
sys.modules["libero.libero.envs"] = envs
installed_root = os.path.dirname(os.path.abspath(core.__file__))
assert core.get_libero_path("benchmark_root") == installed_root
core.set_libero_default_path(installed_root)

from libero.libero.benchmark import Benchmark, get_benchmark
from libero.libero.envs import OffScreenRenderEnv

suite = get_benchmark("libero_goal")()
assert isinstance(suite, Benchmark)
task = suite.get_task(8)
root = core.get_libero_path("bddl_files")
folders = [d for d in os.listdir(root) if "goal" in d and d.endswith(("_lan", "_swap", "_task"))]
assert sorted(folders) == ["libero_goal_lan", "libero_goal_swap", "libero_goal_task"], folders
assert os.path.isfile(suite.get_task_bddl_file_path(8))
original_states = suite.get_task_init_states(8)
changed = get_benchmark("LIBERO_GOAL_SWAP")()
assert changed.get_task_names() == suite.get_task_names()
states = changed.get_task_init_states(8)
assert states.shape == original_states.shape == (50, 79)
assert not np.array_equal(states, original_states)
file = os.path.join(core.get_libero_path("init_states"), "libero_goal_swap", task.init_states_file)
assert os.path.isfile(file)

for tasks in (suite, changed):
    env = OffScreenRenderEnv(
        bddl_file_name=tasks.get_task_bddl_file_path(8), camera_heights=16, camera_widths=16
    )
    env.seed(0)
    env.reset()
    state = tasks.get_task_init_states(8)[3]
    observation = env.set_init_state(state)
    np.testing.assert_array_equal(env.get_sim_state()[1:], state[1:])
    bowl, plate = observation["akita_black_bowl_1_pos"], observation["plate_1_pos"]
    print(*np.round(bowl, 3), *np.round(plate, 3))
    env.close()
"""


@pytest.fixture(scope="module", autouse=True)
def task_files() -> None:
    from liberopro.liberopro.files import folder

    try:
        folder()
    except FileNotFoundError as error:
        pytest.skip(f"LIBERO-PRO's task files cannot be fetched: {error}")


def test_rlinf_finds_the_suites_their_states_and_environments(python: Any) -> None:
    done = python("-c", AS_RLINF)
    assert done.returncode == 0, done.stderr
    positions = [line.split() for line in done.stdout.splitlines()]
    assert len(positions) == 2 and positions[0] != positions[1], "the objects are not swapped"


def test_states_are_written_as_libero_writes_them() -> None:
    import zipfile

    from libero.libero import get_libero_path
    from liberopro.liberopro.files import SUITES, folder

    def members(path: object) -> list[tuple[str, int]]:
        with zipfile.ZipFile(str(path)) as archive:
            return [(member.filename, member.compress_type) for member in archive.infolist()]

    name = "put_the_bowl_on_the_plate.pruned_init"
    liberos = members(f"{get_libero_path('init_states')}/libero_goal/{name}")
    assert members(folder() / "init_files" / "libero_goal_swap" / name) == liberos
    for suite in SUITES:
        assert len(list((folder() / "bddl_files" / suite).glob("*.bddl"))) == 10, suite
        assert len(list((folder() / "init_files" / suite).glob("*.pruned_init"))) == 10, suite
