"""Real simulators from the package index, each in an environment of its own: those that this
interpreter has. `cargo xtask test --suite simulators` makes the environments."""

import argparse
import importlib
import importlib.util
import os
import pathlib
import sys

import numpy as np
import pytest

from rollout_env import Client, Settings, open_simulator
from rollout_env.check import check
from rollout_env.description import Camera
from rollout_env.settings import arguments, settings

FOLDER = pathlib.Path(__file__).parent
FOLDERS = [str(FOLDER), str(FOLDER.parents[1] / "rollout_env" / "examples")]
METAWORLD = (
    "gym:Meta-World/MT1 --tasks env_name=reach-v3,push-v3 --action x,y,z,gripper --size 64x64 "
    "--state eef_pos=observation[0:3] --camera agentview=mujoco.corner2"
)
ROBOSUITE = (
    "gym:robosuite_tasks:make() --tasks task=Lift,Stack --action x,y,z,roll,pitch,yaw,gripper "
    "--size 64x64 --state proprio=robot0_proprio-state --camera agentview=mujoco.agentview "
    "--camera robot0_eye_in_hand=mujoco.robot0_eye_in_hand"
)
VLA_EVAL = (
    "vla-eval:reacher_benchmark:Reacher --tasks reach --set max_steps=30 --control-hz 50 "
    "--action x,y"
)
#: Drawn through Vulkan, without a GPU by the lavapipe of Mesa 25 (Debian 12's 22.3 cannot).
MANI_SKILL = (
    "gym:mani_skill.envs:PickCube-v1 --set obs_mode=rgb --set sim_backend=physx_cpu "
    "--set control_mode=pd_ee_delta_pose --action x,y,z,roll,pitch,yaw,gripper --control-hz 20"
)
#: Package, SPEC with options.
SIMULATORS = {
    "metaworld": ("metaworld", METAWORLD),
    "robosuite": ("robosuite", ROBOSUITE),
    "aloha": ("gym_aloha", "gym:gym_aloha/AlohaTransferCube-v0 --set obs_type=pixels_agent_pos"),
    "pusht": ("gym_pusht", "gym:gym_pusht/PushT-v0 --set obs_type=pixels_agent_pos"),
    "vla_eval": ("vla_eval", VLA_EVAL),
    "mani_skill": ("mani_skill", MANI_SKILL),
    "lerobot": ("lerobot", "lerobot:pusht/PushT-v0"),
}


def prepare(name: str, monkeypatch: pytest.MonkeyPatch) -> tuple[str, Settings]:
    """Returns the simulator's SPEC with options, and its settings; skips without its package."""
    package, spec = SIMULATORS[name]
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"{package} is not installed in this environment")
    monkeypatch.setenv("MUJOCO_GL", "egl")
    for folder in FOLDERS:
        monkeypatch.syspath_prepend(folder)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    parser = argparse.ArgumentParser()
    arguments(parser)
    return spec, settings(parser.parse_args(spec.split()))


@pytest.mark.parametrize("name", SIMULATORS)
def test_a_simulator_conforms(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    _, options = prepare(name, monkeypatch)
    findings = list(check(lambda: open_simulator(options)))
    assert not [one for one in findings if one.is_error], findings


@pytest.mark.parametrize("name", SIMULATORS)
def test_every_task_runs_through_the_pipe(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    spec, _ = prepare(name, monkeypatch)
    with Client([sys.executable, "-m", "rollout_env", "serve", *spec.split()]) as pipe:
        about = pipe.description
        cameras = [Camera(**camera) for camera in about["cameras"]]
        actions = np.random.default_rng(1).uniform(-1, 1, (10, len(about["action"]))).tolist()
        for task in about["tasks"]:
            runs = []
            for seed in (3, 3, 4):
                started = pipe.reset(task["name"], seed, cameras)
                answer = pipe.step(actions)
                frames = [frame.tobytes() for frame in pipe.frames().values()]
                assert all(any(frame) for frame in frames)
                runs.append((started["digest"], answer["state"], frames))
            assert runs[0] == runs[1] and runs[0][0] != runs[2][0]


def test_metaworlds_experts_succeed_through_the_pipe(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same rollout twice: one seed is one rollout, action by action."""
    prepare("metaworld", monkeypatch)
    experts = importlib.import_module("metaworld_experts")
    with experts.serve("reach-v3,push-v3") as pipe:
        for task in ("reach-v3", "push-v3"):
            (first, actions), (second, again) = (experts.rollout(pipe, task, 5) for _ in range(2))
            assert first and second and np.array_equal(actions, again)
