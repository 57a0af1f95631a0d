"""LIBERO-Plus' package compared with the program `worker`: states, frames and prompts are those of
the worker's rollouts of the student, in variants of each dimension for which LIBERO's assets
suffice."""

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("liberoplus", reason="rollout-libero-shim is not installed")

from liberoplus.liberoplus import benchmark
from liberoplus.liberoplus.envs import OffScreenRenderEnv

BOWL = "put_the_bowl_on_the_plate"
#: Ids of the worker's rollouts, by the variants' names.
VARIANTS = {
    f"{BOWL}_view_0_0_181_0_0_initstate_0": "goal/t8/plus:view_0_0_181_0_0/i00",
    f"{BOWL}_view_0_0_100_0_0_initstate_409": "goal/t8/plus:initstate_409/i00",
    f"{BOWL}_view_0_0_100_0_0_initstate_0_noise_39": "goal/t8/plus:noise_39/i00",
    f"{BOWL}_view_0_0_100_0_0_initstate_0_noise_9": "goal/t8/plus:noise_9/i00",
    f"{BOWL}_language_1_view_0_0_100_0_0_initstate_0": "goal/t8/plus:language_1/i00",
    f"{BOWL}_moved_level1_sample1": "goal/t8/plus:level1_sample1/i00",
    "pick_up_the_alphabet_soup_and_place_it_in_the_basket_tb_18": "object/t0/plus:tb_18/i00",
}
#: Seed and waiting steps of the protocol `plus-official`.
SEED, WAITS = 0, 10
#: Control steps between two queries of the student.
EXECUTED = 8
NO_OP = [0.0] * 6 + [-1.0]


@pytest.fixture(scope="module")
def endpoint(programs: Path) -> Iterator[str]:
    """Address of a server of `builtin:student`."""
    command = [programs / "policy-gateway", "--listen", "127.0.0.1:0"]
    with subprocess.Popen(
        [*command, "--route", "student=builtin:student"], stdout=subprocess.PIPE, text=True
    ) as gateway:
        assert gateway.stdout is not None
        yield f"http://{gateway.stdout.readline().split()[-1]}"
        gateway.terminate()


@pytest.fixture(scope="module")
def rollouts(
    programs: Path, endpoint: str, real_assets: Path, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """The folder of the worker's rollouts."""

    def worker(*arguments: Any) -> subprocess.CompletedProcess[str]:
        command = list(map(str, (programs / "worker", *arguments)))
        return subprocess.run(command, capture_output=True, text=True)

    fetched = worker("assets", "fetch", "--suite", "libero-plus")
    if fetched.returncode:
        pytest.skip(f"LIBERO-Plus' task files cannot be fetched: {fetched.stderr}")
    folder = tmp_path_factory.mktemp("plus")
    for name, rollout in VARIANTS.items():
        to = ("--no-video", "--endpoint", endpoint, "--output", folder / name)
        ran = worker("rollout", "--id", rollout, *to)
        assert ran.returncode == 0, ran.stderr
    return folder


@pytest.mark.parametrize("name", VARIANTS)
def test_a_rollout_equals_the_workers(name: str, rollouts: Path) -> None:
    result = json.loads((rollouts / name / "result.json").read_text())
    trace = np.load(rollouts / name / "trace.npz")
    files = (rollouts / name).glob("frames/query-*-agentview.png")
    file_of_step = {EXECUTED * int(file.name.split("-")[1]): file for file in files}
    assert len(file_of_step) == 2 and 0 in file_of_step, "the first and the last query have frames"
    suite = benchmark.get_benchmark("libero_" + VARIANTS[name].split("/")[0])()
    i = suite.get_task_names().index(name)
    assert suite.get_task(i).language == result["finished"]["outcome"]["prompt"]
    height, width, _ = np.asarray(Image.open(file_of_step[0])).shape
    env = OffScreenRenderEnv(
        bddl_file_name=suite.get_task_bddl_file_path(i), camera_heights=height, camera_widths=width
    )
    env.seed(SEED)
    env.reset()
    env.set_init_state(suite.get_task_init_states(i)[0])
    for _ in range(WAITS):
        observation, *_ = env.step(NO_OP)
    for step, action in enumerate([*trace["actions"], None]):
        np.testing.assert_array_equal(env.sim.data.qpos, trace["qpos"][step], err_msg=f"{step}")
        if step in file_of_step:
            file = file_of_step.pop(step)
            for camera in ("agentview", "robot0_eye_in_hand"):
                picture = Image.open(file.with_name(file.name.replace("agentview", camera)))
                upright = observation[f"{camera}_image"][::-1]
                np.testing.assert_array_equal(
                    upright, np.asarray(picture), err_msg=f"{camera} {step}"
                )
        if action is not None:
            observation, _, success, _ = env.step(action)
            assert success == trace["success"][step + 1]
    assert not file_of_step and success == result["finished"]["outcome"]["success"]
    env.close()
