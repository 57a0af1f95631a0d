"""The shim's own behaviour: folders, suites, misuse and several environments."""

import os
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rollout_libero
from libero.libero import benchmark, get_libero_path, paths
from libero.libero.envs import (
    TASK_MAPPING,
    ControlEnv,
    DummyVectorEnv,
    OffScreenRenderEnv,
    SegmentationRenderEnv,
    SubprocVectorEnv,
    bddl_utils,
)
from rollout_libero import scenes

NO_OP = [0.0] * 6 + [-1.0]


@pytest.fixture
def env(bddl_file: str) -> Any:
    constructed = OffScreenRenderEnv(bddl_file_name=bddl_file, camera_heights=32, camera_widths=32)
    constructed.seed(0)
    constructed.reset()
    yield constructed
    constructed.close()


def test_a_problem_evaluates_any_predicate(env: Any) -> None:
    problem = env.env
    goals = problem.parsed_problem["goal_state"]
    assert all(problem._eval_predicate(goal) for goal in goals) == env.check_success()
    turned_on = ["turnon", "flat_stove_1"]
    assert not problem._eval_predicate(turned_on)
    problem.sim.data.set_joint_qpos("flat_stove_1_button", 1.0)
    problem.sim.forward()
    assert problem._eval_predicate(turned_on)
    with pytest.raises(ValueError, match="grasp"):
        problem._eval_predicate(["grasp", "plate_1"])


# Folders.


def test_importing_needs_no_input_configuration_or_heavy_package(
    tmp_path: Path, python: Any
) -> None:
    code = (
        "import sys, libero.libero, libero.libero.benchmark, libero.libero.envs\n"
        "print([m for m in ('torch', 'mujoco', 'robosuite', 'OpenGL') if m in sys.modules])"
    )
    settings = tmp_path / "settings"
    done = python("-c", f"import os; os.close(0)\n{code}", LIBERO_CONFIG_PATH=str(settings))
    assert (done.returncode, done.stdout, done.stderr) == (0, "[]\n", "")
    assert not settings.exists()


def test_without_a_configuration_folders_are_those_of_the_fetched_files(config_file: Path) -> None:
    bddl_files = Path(get_libero_path("bddl_files"))
    assert (bddl_files / "libero_goal" / "turn_on_the_stove.bddl").is_file()
    init_states = Path(get_libero_path("init_states"))
    assert (init_states / "libero_goal" / "turn_on_the_stove.pruned_init").is_file()
    assert get_libero_path("benchmark_root") == os.path.dirname(os.path.abspath(paths.__file__))
    assert get_libero_path("assets") == paths.get_assets_path()
    with pytest.raises(KeyError, match="ask for one of benchmark_root"):
        get_libero_path("robots")


def test_a_configured_folder_is_used_if_it_has_files(config_file: Path, tmp_path: Path) -> None:
    mine = tmp_path / "mine"
    (mine / "libero_goal").mkdir(parents=True)
    config_file.write_text(f"bddl_files: {mine}\ninit_states: {tmp_path / 'gone'}\n")
    assert get_libero_path("bddl_files") == str(mine)
    assert Path(get_libero_path("init_states"), "libero_goal").is_dir()


def test_a_configuration_with_folders_of_the_package_is_ignored(config_file: Path) -> None:
    # torchrl writes this configuration before its first import of LIBERO.
    import libero.libero

    root = os.path.dirname(libero.libero.__file__)
    folders = {
        "benchmark_root": root,
        "bddl_files": os.path.join(root, "bddl_files"),
        "init_states": os.path.join(root, "init_files"),
        "datasets": os.path.abspath(os.path.join(root, "..", "datasets")),
        "assets": os.path.join(root, "assets"),
    }
    config_file.write_text("".join(f"{key}: '{value}'\n" for key, value in folders.items()))
    assert get_libero_path("benchmark_root") == root
    for key in ("bddl_files", "init_states", "datasets", "assets"):
        assert not get_libero_path(key).startswith(root), key


def test_a_folder_is_set_and_unset(config_file: Path, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no task files"):
        paths.set_libero_default_path(str(tmp_path / "nowhere"))
    (tmp_path / "root" / "bddl_files" / "suite").mkdir(parents=True)
    paths.set_libero_default_path(str(tmp_path / "root"))
    assert get_libero_path("benchmark_root") == str(tmp_path / "root")
    assert get_libero_path("bddl_files") == str(tmp_path / "root" / "bddl_files")
    paths.set_libero_default_path()
    assert not config_file.exists()
    assert get_libero_path("benchmark_root") == paths.get_default_path_dict()["benchmark_root"]


def test_a_configuration_that_is_not_yaml_is_named(config_file: Path) -> None:
    config_file.write_text("bddl_files: [")
    with pytest.raises(ValueError, match="correct or remove it"):
        get_libero_path("bddl_files")


# Suites.


@pytest.mark.parametrize(
    ("suite", "tasks"),
    [
        ("libero_spatial", 10),
        ("libero_object", 10),
        ("libero_goal", 10),
        ("libero_10", 10),
        ("libero_90", 90),
    ],
)
def test_every_task_of_a_suite_has_its_files_and_its_instruction(suite: str, tasks: int) -> None:
    benchmark_suite = benchmark.get_benchmark_dict()[suite]()
    assert benchmark_suite.name == suite
    assert benchmark_suite.n_tasks == benchmark_suite.get_num_tasks() == tasks
    for i in range(tasks):
        task = benchmark_suite.get_task(i)
        assert task.problem_folder == suite
        assert Path(benchmark_suite.get_task_bddl_file_path(i)).is_file()
        assert Path(get_libero_path("init_states"), suite, task.init_states_file).is_file()
        assert task.language and "SCENE" not in task.language and "_" not in task.language
    assert len(set(benchmark_suite.get_task_names())) == tasks


def test_orders_of_tasks() -> None:
    default, reordered = (benchmark.get_benchmark("LIBERO_GOAL")(order) for order in (0, 1))
    assert default.get_task_names()[4] == reordered.get_task_names()[0]
    assert sorted(default.get_task_names()) == sorted(reordered.get_task_names())
    with pytest.raises(ValueError, match="leave task_order_index at 0"):
        benchmark.get_benchmark("libero_90")(1)


def test_unknown_suites_are_refused_with_the_list_of_suites() -> None:
    assert "libero_100" in benchmark.get_benchmark_dict()
    with pytest.raises(KeyError, match="libero_90 and libero_10"):
        benchmark.get_benchmark("libero_100")()
    with pytest.raises(KeyError, match="choose one of libero_spatial"):
        benchmark.get_benchmark("libero_space")


def test_initial_states_are_an_array_and_need_no_torch() -> None:
    states = benchmark.get_benchmark("libero_goal")().get_task_init_states(8)
    assert type(states) is np.ndarray
    assert states.dtype == np.float64
    assert states.shape == (50, 79)
    assert states.flags.writeable
    assert (states[:, 0] == states[0, 0]).all()


# BDDL.


def test_a_problems_info_is_read(bddl_file: str) -> None:
    assert bddl_utils.get_problem_info(bddl_file) == {
        "problem_name": "libero_tabletop_manipulation",
        "domain_name": "robosuite",
        "language_instruction": "put the bowl on the plate",
    }
    with pytest.raises(ValueError, match="leaves a parenthesis open"):
        bddl_utils.scan_tokens(string="(define (problem a)")
    with pytest.raises(ValueError, match="never opened"):
        bddl_utils.scan_tokens(string="(define))")


# Environments.


def test_features_that_only_the_original_has_are_refused_with_the_remedy(bddl_file: str) -> None:
    for argument, value in {
        "controller": "JOINT_POSITION",
        "control_freq": 10,
        "robots": ["Sawyer"],
        "has_renderer": True,
        "renderer": "nvisii",
        "initialization_noise": "default",
        "gripper_types": "RobotiqGripper",
        "render_collision_mesh": True,
        "scene_properties": {"floor_style": "wood"},
    }.items():
        with pytest.raises(NotImplementedError, match=f"{argument}=.*not supported.*: "):
            ControlEnv(bddl_file, **{argument: value})
    with pytest.raises(TypeError, match="no argument `camera_height`"):
        OffScreenRenderEnv(bddl_file_name=bddl_file, camera_height=64)
    with pytest.raises(ValueError, match="give use_camera_obs=False"):
        ControlEnv(bddl_file, has_offscreen_renderer=False)
    with pytest.raises(ValueError, match="no camera `topview`.*agentview"):
        OffScreenRenderEnv(bddl_file_name=bddl_file, camera_names="topview")
    with pytest.raises(ValueError, match="3 values for 2 cameras"):
        OffScreenRenderEnv(bddl_file_name=bddl_file, camera_heights=[1, 2, 3])
    with pytest.raises(ValueError, match="choose one of instance"):
        OffScreenRenderEnv(bddl_file_name=bddl_file, camera_segmentations="pixel")


def test_missing_files_are_named_with_the_remedy(
    bddl_file: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with pytest.raises(FileNotFoundError, match="get_task_bddl_file_path"):
        OffScreenRenderEnv(bddl_file_name="nowhere.bddl")
    monkeypatch.setenv("ROLLOUT_ASSETS", str(tmp_path))
    with pytest.raises(FileNotFoundError, match="asset pack"):
        OffScreenRenderEnv(bddl_file_name=bddl_file)


def test_a_scene_outlives_its_environments(
    bddl_file: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def construct(file: str) -> None:
        env = OffScreenRenderEnv(bddl_file_name=file, camera_heights=16, camera_widths=16)
        env.reset()
        env.close()

    copied_file = tmp_path / "own.bddl"
    copied_file.write_text(Path(bddl_file).read_text())
    compiled: list[Any] = []
    native = scenes.native

    class Native:
        Scene = staticmethod(lambda *a, **k: compiled.append(a) or native.Scene(*a, **k))
        fetch_assets = staticmethod(native.fetch_assets)

    monkeypatch.setattr(scenes, "native", Native)
    for _ in range(3):
        construct(str(copied_file))
    assert len(compiled) == 1
    # A changed file gives another scene.
    copied_file.write_text(copied_file.read_text() + "\n")
    construct(str(copied_file))
    assert len(compiled) == 2
    suite = benchmark.get_benchmark("libero_goal")()
    for i in range(scenes.MAX_RECENT):
        construct(suite.get_task_bddl_file_path(i))
    assert len(scenes._recent) == scenes.MAX_RECENT


def test_actions_of_another_shape_are_refused(env: OffScreenRenderEnv) -> None:
    for action in ([0.0] * 6, [[0.0] * 7], 0.0, [0.0] * 8):
        with pytest.raises(ValueError, match="an action has 7 numbers"):
            env.step(action)
    assert env.env.timestep == 0
    env.step(tuple(NO_OP))
    env.step(np.zeros(7, dtype=np.float32))
    assert env.env.timestep == 2


def test_states_of_another_scene_are_refused(env: OffScreenRenderEnv) -> None:
    with pytest.raises(ValueError, match="state of this task"):
        env.set_init_state(np.zeros(71))


def test_a_closed_environment_is_reported(bddl_file: str) -> None:
    env = OffScreenRenderEnv(bddl_file_name=bddl_file, use_camera_obs=False)
    sim, domain = env.sim, env.env
    controller = env.robots[0].controller
    env.close()
    env.close()
    for use in (
        env.reset,
        lambda: env.step(NO_OP),
        env.get_sim_state,
        env.check_success,
        lambda: env.env,
        lambda: sim.data.qpos,
        lambda: sim.model.nq,
        lambda: controller.ee_pos,
        domain.reset,
    ):
        with pytest.raises(rollout_libero.ClosedError, match="construct a new one"):
            use()


def test_two_threads_in_one_environment_get_an_error(env: OffScreenRenderEnv) -> None:
    outcomes: list[Exception | None] = []

    def step_repeatedly() -> None:
        for _ in range(40):
            try:
                env.step(NO_OP)
                outcomes.append(None)
            except rollout_libero.BusyError as error:
                outcomes.append(error)

    threads = [threading.Thread(target=step_repeatedly) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(outcomes) == 160
    errors = [error for error in outcomes if error is not None]
    assert errors, "no two threads used the environment at the same time"
    assert all("thread" in str(error) for error in errors)
    env.step(NO_OP)


def test_a_step_after_the_end_is_refused_with_the_remedy(bddl_file: str) -> None:
    env = OffScreenRenderEnv(bddl_file_name=bddl_file, use_camera_obs=False, horizon=1)
    env.reset()
    env.step(NO_OP)
    with pytest.raises(ValueError, match="terminated episode.*call reset"):
        env.step(NO_OP)
    env.reset()
    env.step(NO_OP)
    env.close()


def test_a_global_generator_other_than_mt19937_is_refused(env: OffScreenRenderEnv) -> None:
    before = np.random.get_bit_generator()
    np.random.set_bit_generator(np.random.PCG64(1))
    try:
        with (
            pytest.warns(RuntimeWarning),
            pytest.raises(RuntimeError, match="is PCG64.*set it back"),
        ):
            env.reset()
    finally:
        np.random.set_bit_generator(before)
    env.reset()


def test_writing_to_copied_arrays_raises(env: OffScreenRenderEnv) -> None:
    with pytest.raises(ValueError, match=r"sim.model.set\('cam_pos'"):
        env.sim.model.cam_pos[0] = 0
    with pytest.raises(ValueError, match="set_state_from_flattened"):
        env.sim.data.qpos[3:5] = 0
    with pytest.raises(AttributeError, match="sim.model.set"):
        env.sim.model.body_pos = 0
    with pytest.raises(AttributeError, match="set_state_from_flattened"):
        env.sim.data.qpos = 0
    computed = env.sim.data.qpos + 1
    computed[0] = 3.0
    assert computed[0] == 3.0


def test_a_camera_is_moved_in_one_environment_only(bddl_file: str) -> None:
    arguments = {"bddl_file_name": bddl_file, "camera_heights": 48, "camera_widths": 48}
    moved, unmoved = (OffScreenRenderEnv(**arguments) for _ in range(2))
    frames = []
    for env in (moved, unmoved):
        env.seed(0)
        frames.append(env.reset()["agentview_image"])
    np.testing.assert_array_equal(*frames)
    positions = moved.sim.model.cam_pos.copy()
    positions[moved.sim.model.camera_name2id("agentview")] += [0.1, 0.2, 0.0]
    moved.sim.model.set("cam_pos", positions)
    np.testing.assert_array_equal(moved.sim.model.cam_pos, positions)
    after = [env.step(NO_OP)[0]["agentview_image"] for env in (moved, unmoved)]
    assert (after[0] != after[1]).mean() > 0.2
    for env in (moved, unmoved):
        env.close()


def test_rendering_the_current_state_does_not_shift_observations(bddl_file: str) -> None:
    def run(renders: bool) -> list[Any]:
        env = OffScreenRenderEnv(bddl_file_name=bddl_file, use_camera_obs=False)
        env.seed(0)
        env.reset()
        readings = []
        for i in range(4):
            readings.append(env.step([0.5, 0.1 * i, -0.2, 0.3, 0, 0, 1])[0]["robot0_proprio-state"])
            if renders:
                env.sim.render(camera_name="agentview", width=16, height=16)
        env.close()
        return readings

    np.testing.assert_array_equal(run(renders=True), run(renders=False))


def test_omitted_keys_are_not_observed(env: OffScreenRenderEnv) -> None:
    env.env.modify_observable("agentview_image", "enabled", False)
    env.env.modify_observable("robot0_joint_vel", "active", False)
    observation, *_ = env.step(NO_OP)
    assert "agentview_image" not in observation
    assert observation["robot0_proprio-state"].shape == (32,)
    env.env.modify_observable("agentview_image", "enabled", True)
    assert "agentview_image" in env.step(NO_OP)[0]
    with pytest.raises(KeyError, match="there is no observation"):
        env.env.modify_observable("sideview_image", "enabled", True)
    with pytest.raises(NotImplementedError, match="corrupter"):
        env.env.modify_observable("agentview_image", "corrupter", None)


def test_omitted_modules_are_refused_with_the_remedy(env: OffScreenRenderEnv) -> None:
    for module in (
        "libero.lifelong",
        "libero.libero.utils.dataset_utils",
        "libero.libero.envs.objects",
    ):
        with pytest.raises(ImportError, match=f"{module} is not part of rollout-libero-shim: "):
            __import__(f"{module}.more", fromlist=["x"])
    with pytest.raises(ImportError, match="libero.libero.envs.objects is not part"):
        from libero.libero.envs import objects  # noqa: F401
    with pytest.raises(AttributeError, match="_model.*MuJoCo's own objects are not shown"):
        _ = env.sim.model._model
    with pytest.raises(AttributeError, match="`step` in rollout-libero-shim"):
        env.sim.step()
    with pytest.raises(NotImplementedError, match="BDDL file"):
        env.reset_from_xml_string("<mujoco/>")
    with pytest.raises(NotImplementedError, match="force=True"):
        env._update_observables()
    with pytest.raises(AttributeError, match="only use_delta can be set"):
        env.robots[0].controller.kp = 10


def test_an_environment_is_constructed_from_its_problem_class(bddl_file: str) -> None:
    problem = bddl_utils.get_problem_info(bddl_file)["problem_name"]
    config = {"type": "OSC_POSE", "kp": 150, "control_delta": False}
    arguments = {"robots": ["Panda"], "use_camera_obs": False, "reward_scale": 2.0}
    env = TASK_MAPPING[problem](bddl_file, controller_configs=config, **arguments)
    assert not env.robots[0].controller.use_delta
    env.reset()
    assert not env.robots[0].controller.use_delta
    assert env.reward() == 0.0
    assert env.language_instruction == "put the bowl on the plate"
    env.close()
    with pytest.raises(NotImplementedError, match=r"controller_configs\['kp'\]"):
        TASK_MAPPING[problem](bddl_file, controller_configs={**config, "kp": 80}, **arguments)
    with pytest.raises(ValueError, match="take the class from TASK_MAPPING"):
        TASK_MAPPING["libero_floor_manipulation"](bddl_file, **arguments)


def test_segmentations_are_split_by_instance(bddl_file: str) -> None:
    env = SegmentationRenderEnv(bddl_file_name=bddl_file, camera_names="agentview")
    observation = env.reset()
    segments = observation["agentview_segmentation_instance"]
    parts = env.get_segmentation_instances(segments)
    assert parts["robot"].any() and parts["plate_1"].any()
    visible = {part for part in parts if parts[part].any()}
    assert (
        sum((parts[part] > 0).sum() for part in visible - {"MountedPanda0"}) == (segments > 0).sum()
    )
    interest = env.get_segmentation_of_interest(segments)
    bowl = segments == env.instance_to_id["akita_black_bowl_1"]
    assert bowl.any() and (interest[bowl] == 1).all() and (interest[segments == 0] == -1).all()
    env.close()


# Several environments.


class Constructor:
    """A constructor of environments that can be sent to a process."""

    def __init__(self, bddl_file: str) -> None:
        self.bddl_file = bddl_file

    def __call__(self) -> OffScreenRenderEnv:
        return OffScreenRenderEnv(
            bddl_file_name=self.bddl_file, camera_heights=16, camera_widths=16, horizon=5
        )


def hand_positions(observations: Any) -> list[Any]:
    return [observation["robot0_eef_pos"] for observation in observations]


@pytest.mark.parametrize("kind", [DummyVectorEnv, SubprocVectorEnv])
def test_several_environments_equal_single_environments(kind: Any, bddl_file: str) -> None:
    state = benchmark.get_benchmark("libero_goal")().get_task_init_states(8)
    envs = kind([lambda: Constructor(bddl_file)() for _ in range(3)])
    assert len(envs) == 3
    envs.seed([5, 6, 7])
    assert envs.reset().shape == (3,)
    observations = envs.set_init_state(init_state=state[:3])
    actions = np.array([[0.1 * i, 0.2, 0, 0, 0, 0, -1] for i in range(3)])
    observations, rewards, dones, infos = envs.step(actions)
    assert observations.shape == rewards.shape == dones.shape == infos.shape == (3,)
    assert [info["env_id"] for info in infos] == [0, 1, 2]
    assert envs.check_success() == [False] * 3
    assert len(envs.get_env_attr("language_instruction")) == 3

    single = Constructor(bddl_file)()
    single.seed(7)
    single.reset()
    single.set_init_state(state[2])
    alone, *_ = single.step(actions[2])
    if kind is SubprocVectorEnv:
        # Environments of one process share NumPy's generator, which places the fixtures.
        np.testing.assert_array_equal(alone["agentview_image"], observations[2]["agentview_image"])
    np.testing.assert_allclose(alone["robot0_eef_pos"], observations[2]["robot0_eef_pos"], atol=0)
    np.testing.assert_array_equal(single.get_sim_state(), envs.get_sim_state()[2])
    single.close()

    observations_of_two, *_ = envs.step(actions[1:], id=[1, 2])
    assert len(observations_of_two) == 2
    assert envs.reset(id=[1]).shape == (1,)
    with pytest.raises(ValueError, match="give one each"):
        envs.step(actions[:2])
    with pytest.raises(ValueError, match="7 numbers"):
        envs.step([[0.0]], id=[0])
    envs.step(actions[:1], id=0)
    envs.close()
    with pytest.raises(RuntimeError, match="make new ones"):
        envs.step(actions)


@pytest.mark.parametrize("kind", [DummyVectorEnv, SubprocVectorEnv])
def test_after_an_error_answers_belong_to_their_own_calls(kind: Any, bddl_file: str) -> None:
    envs = kind([Constructor(bddl_file)] * 2)
    envs.reset()
    moves = [[0.9, 0.9, 0, 0, 0, 0, -1]] * 2
    with pytest.raises(ValueError, match="7 numbers"):
        envs.step([[0.0], moves[1]])
    # The other environment has stepped. Its answer must not become the answer to the next call.
    before = hand_positions(envs.step(moves)[0])
    after = hand_positions(envs.step(moves)[0])
    states = envs.get_sim_state()
    assert all(np.abs(now - then).max() > 1e-4 for now, then in zip(after, before))
    assert [state[0] for state in states] == pytest.approx([0.1, 0.15])
    with pytest.raises(TypeError):
        envs.reset(unknown=1)
    assert [state[0] for state in envs.get_sim_state()] == pytest.approx([0.1, 0.15])
    envs.close()


def test_the_answer_to_an_interrupted_command_is_dropped(bddl_file: str) -> None:
    envs = SubprocVectorEnv([Constructor(bddl_file)])
    envs.reset()
    envs.workers[0].send([0.9, 0.9, 0, 0, 0, 0, -1])
    assert envs.get_sim_state()[0][0] == pytest.approx(0.05)
    envs.close()


def test_a_failed_construction_in_a_process_raises_its_error(bddl_file: str) -> None:
    envs = SubprocVectorEnv([Constructor("nowhere.bddl")])
    with pytest.raises(FileNotFoundError, match="nowhere.bddl"):
        envs.reset()
    with pytest.raises(NotImplementedError, match="leave wait_num"):
        SubprocVectorEnv([Constructor(bddl_file)] * 2, wait_num=1)
