"""``Environment``, a vector environment of one: its own interface, perturbations, control and
frames."""

import json

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import rollout_libero
from rollout_libero._library import native

from .conftest import TASK, open_the_drawer


def actions(count, seed=0):
    return np.random.default_rng(seed).uniform(-0.6, 0.6, (count, 7))


def assert_same(first, second):
    assert first.keys() == second.keys()
    for name, values in first.items():
        np.testing.assert_array_equal(values, second[name], err_msg=name)


def test_gymnasiums_environment_checker_passes(make):
    check_env(make(), skip_render_check=True)


def test_a_chunk_equals_its_single_steps(make):
    single, chunked = make(), make()
    single.reset(seed=0)
    chunked.reset(seed=0)
    before = chunked.snapshot()
    steps = [single.step(action) for action in actions(4)]
    results = {}
    for render in ("all", "last", "none"):
        chunked.restore(before)
        results[render], reward, terminated, truncated, info = chunked.step_chunk(
            actions(4), render
        )
        assert (reward, terminated, truncated, info["steps"]) == (0.0, False, False, 4)
    for step, (observation, *_) in enumerate(steps):
        assert_same({name: values[step] for name, values in results["all"].items()}, observation)
    assert_same(results["last"], steps[-1][0])
    cameras = {"agentview", "robot0_eye_in_hand"}
    assert cameras <= results["last"].keys() and not cameras & results["none"].keys()


def test_success_ends_a_rollout_and_the_rest_of_its_chunk(make):
    environment = make()
    environment.reset()
    open_the_drawer(environment.simulation)
    observation, reward, terminated, truncated, info = environment.step_chunk(actions(4), "all")
    assert (reward, terminated, truncated) == (1.0, True, False)
    assert info["success"] and info["steps"] == 1
    assert len(observation["agentview"]) == 1
    with pytest.raises(gymnasium.error.ResetNeeded, match="call reset"):
        environment.step(np.zeros(7))


def test_a_configuration_sets_instruction_and_perturbations(make):
    nominal = make()
    perturbed = make(perturbation="simultaneous/L2/c03")
    whole = make(perturbation="goal/t0/simultaneous/L2/c03")
    observation, info = perturbed.reset()
    assert info["instruction"] == whole.instruction != nominal.instruction
    same, _ = nominal.reset(options={"init_state": info["init_state"]})
    for name in ("agentview", "robot0_eye_in_hand", "joint_pos"):
        assert not np.array_equal(observation[name], same[name]), name
    assert_same(observation, whole.reset()[0])
    with pytest.raises(ValueError, match="libero_goal/1"):
        make(perturbation="goal/t1/simultaneous/L2/c03")


def test_sampled_placements_differ_by_seed_alone(make):
    environment = make(init_states="sampled")
    first, second, again = (environment.reset(seed=seed)[0] for seed in (1, 2, 1))
    assert_same(first, again)
    assert not np.array_equal(first["agentview"], second["agentview"])


def test_a_seed_selects_the_initial_state_and_later_resets_continue_from_it(make):
    environment = make(cameras=[])
    assert [environment.reset(seed=seed)[1]["init_state"] for seed in (0, 7, 7, 53)] == [0, 7, 7, 3]
    assert [environment.reset()[1]["init_state"] for _ in range(2)] == [4, 5]
    # The option `init_state` takes precedence over the seed, and changes only this reset: the next
    # reset uses the seed's state.
    assert environment.reset(seed=9, options={"init_state": 2})[1]["init_state"] == 2
    assert environment.reset()[1]["init_state"] == 9
    listed_states = make(cameras=[], init_states=[4, 2])
    assert [listed_states.reset(seed=seed)[1]["init_state"] for seed in range(3)] == [4, 2, 4]
    perturbed = make(cameras=[], perturbation="camera/L2/c03")
    assert len({perturbed.reset(seed=seed)[1]["init_state"] for seed in range(3)}) == 1


def test_a_row_sets_settling_steps_and_budget(make):
    row = json.loads(native.configuration_row("goal/t0/robot/L1/c01"))
    row |= {"num_steps_wait": 4, "max_steps": 3}
    custom = make(cameras=[], settle_steps=None, perturbation=row)
    overridden = make(cameras=[], settle_steps=4, max_steps=3, perturbation="robot/L1/c01")
    assert custom.max_steps == 3
    assert_same(custom.reset()[0], overridden.reset()[0])
    *_, truncated, info = custom.step_chunk(np.zeros((9, 7)))
    assert truncated and info["steps"] == 3
    as_designed = make(cameras=[], settle_steps=None, perturbation="robot/L1/c01")
    assert as_designed.max_steps == as_designed.task.max_steps
    settled = make(cameras=[], settle_steps=10, perturbation="robot/L1/c01").reset()[0]
    assert_same(as_designed.reset()[0], settled)
    assert not np.array_equal(custom.reset()[0]["joint_pos"], settled["joint_pos"])


def test_an_invalid_row_is_refused_at_once(make):
    row = json.loads(native.configuration_row("goal/t0/robot/L1/c01"))
    with pytest.raises(ValueError, match="manifest"):
        make(perturbation=row | {"level": "L2"})
    for wrong in ({"max_steps": 0}, {"settle_steps": -1}):
        with pytest.raises(ValueError, match="or more, or None"):
            make(**wrong)


def test_poses_under_perturbed_actuation_are_refused(make, make_vector):
    for axis in ("actuation", "simultaneous"):
        with pytest.raises(ValueError, match=r"control='relative'.*without the actuation axis"):
            make(control="absolute", perturbation=f"{axis}/L1/c00")
    environment = make(control="absolute", cameras=[], perturbation="robot/L1/c00")
    environment.reset()
    environments = make_vector(num_envs=2, control="absolute", cameras=[])
    with pytest.raises(ValueError, match="control='relative'"):
        environments.set_perturbation(1, "actuation/L1/c00")
    environments.reset()
    # Poses are also refused after the restoration of a snapshot with perturbed actuation.
    distorted = make(cameras=[], perturbation="actuation/L1/c00")
    distorted.reset()
    environment.restore(distorted.snapshot())
    before = environment.simulation.state()
    with pytest.raises(ValueError, match="command displacements"):
        environment.step(np.zeros(7))
    np.testing.assert_array_equal(environment.simulation.state(), before)


def axis_angle(matrix):
    """Returns axis times angle of a rotation by almost half a turn. The axis is the eigenvector
    with eigenvalue 1."""
    values, vectors = np.linalg.eig(matrix)
    axis = np.real(vectors[:, np.argmin(np.abs(values - 1.0))])
    return axis * np.arccos((np.trace(matrix) - 1.0) / 2.0)


def test_absolute_control_holds_the_commanded_pose(make):
    environment = make(control="absolute", max_steps=100)
    observation, _ = environment.reset()
    pos, matrix = environment.simulation.controller_pose()
    target = pos + [0.03, 0.02, -0.02]
    command = np.concatenate([target, axis_angle(matrix), [-1.0]])
    for _ in range(20):
        observation, *_ = environment.step(command)
    np.testing.assert_allclose(observation["eef_pos"], target, atol=5e-3)


@pytest.mark.parametrize("orientation", ["policy", "upright"])
def test_frames_have_the_chosen_orientation_and_render_is_upright(make, make_vector, orientation):
    environment = make(render_mode="rgb_array", orientation=orientation)
    observation, _ = environment.reset()
    raw = environment.simulation.frame("agentview", 80, 64)
    expected = {"policy": raw[::-1, ::-1], "upright": raw[::-1]}[orientation]
    np.testing.assert_array_equal(observation["agentview"], expected)
    np.testing.assert_array_equal(environment.render(), raw[::-1])
    environments = make_vector(num_envs=1, orientation=orientation, init_states=[0])
    several, _ = environments.reset()
    np.testing.assert_array_equal(several["agentview"][0], expected)
    chunk, *_ = environments.step_chunk(np.zeros((1, 2, 7)), "all")
    single, *_ = environment.step_chunk(np.zeros((2, 7)), "all")
    np.testing.assert_array_equal(chunk["agentview"][0], single["agentview"])


def test_frames_have_the_policy_orientation_by_default(make):
    observation, _ = make().reset()
    for camera in ("agentview", "robot0_eye_in_hand"):
        expected, _ = make(orientation="policy").reset()
        np.testing.assert_array_equal(observation[camera], expected[camera])


def test_a_frame_is_rendered_without_any_opengl_library(python):
    done = python(
        "-c",
        "import rollout_libero\n"
        f"environment = rollout_libero.Environment({TASK!r}, 'primitives', height=32, width=32)\n"
        "environment.reset()\n"
        "print(open('/proc/self/maps').read())\n",
    )
    loaded = done.stdout
    assert "libmujoco" in loaded, done.stderr
    for library in ("libEGL", "libGL.", "libOpenGL", "libOSMesa", "libGLX"):
        assert library not in loaded, library


def test_another_mujoco_in_the_process_is_not_called(python):
    pytest.importorskip("mujoco", reason="no other MuJoCo is installed")
    done = python(
        "-c",
        "import mujoco, rollout_libero\n"
        "from rollout_libero._library import native\n"
        "environment = rollout_libero.Environment('libero_goal/0', 'primitives')\n"
        "environment.reset()\n"
        "print(mujoco.mj_versionString(), native.mujoco_version())\n",
    )
    other_version, own_version = done.stdout.split()
    assert own_version == "3.3.7" != other_version


def test_every_task_has_a_name_an_instruction_and_a_budget():
    tasks = rollout_libero.tasks()
    assert len({task.name for task in tasks}) == 40
    assert all(task.instruction and task.max_steps > 200 for task in tasks)
    assert [task.suite for task in rollout_libero.tasks("libero_10")] == ["libero_10"] * 10
