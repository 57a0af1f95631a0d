"""LIBERO-Plus' package: suites, and environments compared with recordings of LIBERO-Plus' own code.
test_rl_clients.py runs RLinf with it."""

import hashlib
import os
import shutil
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("liberoplus", reason="rollout-libero-shim is not installed")

import liberoplus.liberoplus as plus
from liberoplus.liberoplus import benchmark
from liberoplus.liberoplus.envs import OffScreenRenderEnv, SegmentationRenderEnv
from rollout_libero._native import PlusPath, PlusVariant

pytestmark = pytest.mark.usefixtures("plus_files")

ROOT = Path(__file__).resolve().parents[3]
FAMILY = ROOT / "crates/benchmark/tests/recorded"
NO_OP = [0.0] * 6 + [-1.0]
#: Seed of the recorded states.
SEED = 7
#: Largest difference of a coordinate from the recordings, as in `tests/tests/family.rs`.
TOLERANCE = 1e-9
BOWL = "put_the_bowl_on_the_plate"
FOG = f"{BOWL}_view_0_0_100_0_0_initstate_0_noise_39"
IMAGE, WRIST = "agentview_image", "robot0_eye_in_hand_image"


def path(suite: str, name: str) -> str:
    return f"{plus.get_libero_path('bddl_files')}/{suite}/{name}.bddl"


def states(suite: str, name: str) -> Any:
    tasks = benchmark.get_benchmark(suite)()
    names = tasks.get_task_names()
    # Some recorded postures belong to no variant. Their initial states are those of the variant FOG
    # of the same task.
    return tasks.get_task_init_states(names.index(name if name in names else FOG))


def make(name: str, suite: str = "libero_goal", size: int = 32, **arguments: Any) -> Any:
    return OffScreenRenderEnv(
        bddl_file_name=path(suite, name), camera_heights=size, camera_widths=size, **arguments
    )


def recorded() -> dict[str, dict[str, list[float]]]:
    """Returns the numbers that LIBERO-Plus' own code gave for each variant, by kind."""
    numbers_of: dict[str, dict[str, list[float]]] = defaultdict(dict)
    for line in (ROOT / "tests/tests/family/states.txt").read_text().splitlines():
        variant, kind, *numbers = line.split(" ")
        numbers_of[variant][kind] = [float(number) for number in numbers]
    return numbers_of


def digest(lines: list[str]) -> str:
    return hashlib.sha256("".join(f"{line}\n" for line in lines).encode()).hexdigest()


# Suites.


def test_all_variants_are_listed_as_by_the_released_code() -> None:
    lines = defaultdict(list)
    for suite, count in zip(benchmark.libero_suites, (2402, 2518, 2591, 90, 2519)):
        tasks = benchmark.get_benchmark_dict()[suite]()
        assert tasks.n_tasks == tasks.get_num_tasks() == count
    for suite in ("libero_spatial", "libero_object", "libero_goal", "libero_10"):
        tasks = benchmark.get_benchmark(suite.upper())()
        assert isinstance(tasks, benchmark.Benchmark)
        for i, name in enumerate(tasks.get_task_names()):
            task = tasks.get_task(i)
            assert (task.name, task.problem_folder, task.bddl_file) == (name, suite, f"{name}.bddl")
            variant = PlusVariant.find(name)
            assert variant is not None
            level = variant.difficulty
            lines["names"].append(f"{suite} {i + 1} {name} {variant.category} {level}")
            lines["states"].append(variant.states_file)
            file = Path(PlusPath(tasks.get_task_bddl_file_path(i)).file)
            assert file.is_file(), file
            lines["bddl"].append(f"{suite}/{file.stem}")
            if not variant.has_own_sentence:
                lines["released"].append(task.language)
    for line in (FAMILY / "plus.txt").read_text().splitlines():
        kind, count, expected = line.split(" ")
        if kind in lines:
            listed = lines.pop(kind)
            assert (len(listed), digest(listed)) == (int(count), expected), kind
    assert not lines


def test_sentences_of_the_language_dimension_are_those_of_the_bddl_files() -> None:
    tasks = benchmark.get_benchmark("libero_goal")()
    names = tasks.get_task_names()
    task = tasks.get_task(names.index(f"{BOWL}_language_1_view_0_0_100_0_0_initstate_0"))
    file = Path(path("libero_goal", f"{BOWL}_language_1")).read_text().lower()
    assert f"(:language {task.language})" in " ".join(file.split())
    assert task.language != BOWL.replace("_", " ")
    assert benchmark.grab_language_from_filename("libero_goal", task.bddl_file) == task.language
    plain = benchmark.grab_language_from_filename("libero_goal", f"{BOWL}.bddl")
    assert plain == BOWL.replace("_", " ")


def test_a_variant_has_fifty_states_or_one() -> None:
    assert states("libero_goal", f"{BOWL}_moved_level1_sample1").shape == (1, 79)
    assert states("libero_goal", f"{BOWL}_light_1").shape == (50, 79)
    with pytest.raises(FileNotFoundError, match="libero.libero.benchmark"):
        benchmark.get_benchmark("libero_90")().get_task_init_states(0)
    with pytest.raises(ValueError, match="task_order_index"):
        benchmark.get_benchmark("libero_goal")(1)


# Environments.


@pytest.mark.usefixtures("real_assets")
@pytest.mark.parametrize(
    "variant", [name for name in recorded() if "noise" not in recorded()[name]]
)
def test_states_cameras_and_random_numbers_equal_the_originals(variant: str) -> None:
    expected = recorded()[variant]
    suite, name = variant.split("/")
    env = make(name, suite, use_camera_obs=False)

    def check(kind: str, numbers: Any) -> None:
        np.testing.assert_allclose(numbers, expected[kind], rtol=0, atol=TOLERANCE, err_msg=kind)

    def wait(steps: int) -> None:
        for _ in range(steps):
            env.step(NO_OP)

    env.seed(SEED)
    env.reset()
    assert np.random.random_sample() == expected["draw"][0]
    check("reset", env.get_sim_state())
    model = env.sim.model
    camera = model.camera_name2id("agentview")
    check("camera", [*model.cam_pos[camera], *model.cam_quat[camera]])
    wait(15)
    check("reset-only", env.get_sim_state())
    env.close()
    env = make(name, suite, use_camera_obs=False)
    env.seed(SEED)
    env.reset()
    env.set_init_state(states(suite, name)[0])
    wait(10)
    check("official", env.get_sim_state())
    env.close()


@pytest.mark.usefixtures("real_assets")
@pytest.mark.parametrize("variant", [name for name in recorded() if "noise" in recorded()[name]])
def test_unread_frames_draw_the_same_random_numbers_as_read_frames(variant: str) -> None:
    last = []
    for reads_all in (False, True):
        suite, name = variant.split("/")
        env = make(name, suite, size=256)
        env.seed(SEED)
        observation = env.reset()
        if reads_all:
            observation.draw()
        env.set_init_state(states(suite, name)[0])
        for _ in range(10):
            observation, *_ = env.step(NO_OP)
            if reads_all:
                observation.draw()
        assert np.random.random_sample() == recorded()[variant]["noise"][0]
        last.append(observation[IMAGE])
        env.close()
    np.testing.assert_array_equal(*last)


def test_the_observation_of_an_initial_state_and_other_cameras_are_not_corrupted() -> None:
    env, clean = make(FOG), make(f"{BOWL}_view_0_0_100_0_0_initstate_0_noise_0")
    start = states("libero_goal", FOG)[0]

    def call_both(function: Any) -> tuple[Any, Any, Any, Any]:
        """Calls the function with both environments. Returns the corrupted and the clean
        observation, and the generator's states before and after the corruption."""
        np.random.seed(3)
        plain = function(clean)
        before = np.random.get_state()
        np.random.seed(3)
        return function(env), plain, before, np.random.get_state()

    for function in (lambda env: env.reset(), lambda env: env.step(NO_OP)[0]):
        corrupted, plain, before, after = call_both(function)
        np.testing.assert_array_equal(corrupted[WRIST], plain[WRIST])
        change = PlusPath(path("libero_goal", FOG))
        np.testing.assert_array_equal(corrupted[IMAGE], change.corrupted(before, plain[IMAGE]))
        assert not np.array_equal(corrupted[IMAGE], plain[IMAGE])
        skipped = change.skip(before, 32, 32)
        np.testing.assert_array_equal(after[1], skipped[1])
        assert after[2:] == skipped[2:] != before[2:]
    initial, plain, before, after = call_both(lambda env: env.set_init_state(start))
    np.testing.assert_array_equal(initial[IMAGE], plain[IMAGE])
    np.testing.assert_array_equal(after[1], before[1])
    for environment in (env, clean):
        environment.close()


def test_corruptions_of_pictures_equal_the_originals() -> None:
    for line in (FAMILY / "corruptions.txt").read_text().splitlines():
        number, side, *expected, draw = line.split(" ")
        if int(number) % 10 != 1:
            continue
        change = PlusPath(f"a_view_0_0_100_0_0_initstate_0_noise_{number}.bddl")
        picture = picture_of_the_recordings(int(side))
        np.random.seed(1000 + int(number))
        for expected_digest in expected:
            state = np.random.get_state()
            corrupted = change.corrupted(state, picture)
            assert hashlib.sha256(corrupted.tobytes()).hexdigest()[:16] == expected_digest, line
            np.random.set_state(change.skip(state, int(side), int(side)))
        assert np.random.random_sample() == float(draw), line


def picture_of_the_recordings(side: int) -> Any:
    """Returns the picture of `corruptions.py`: flat tiles above, a gradient and noise below."""
    noise = np.random.RandomState(side).randint(0, 256, size=(side, side, 3))
    rows, columns = np.mgrid[0:side, 0:side]
    block = (rows // 8) * (side // 16) + columns // 16
    flat = np.stack([block % 256, 255 - block % 256, block * 7 % 256], axis=-1)
    gradient = np.stack([rows, columns, rows + columns], axis=-1) * 255 // (2 * side)
    upper, left = (rows < side // 2)[..., None], (columns < side // 2)[..., None]
    return np.where(upper, flat, np.where(left, gradient, noise)).astype(np.uint8)


def test_postures_outlive_an_initial_state_and_are_reported_by_the_robot() -> None:
    name = f"{BOWL}_view_0_0_100_0_0_initstate_409"
    env = make(name, use_camera_obs=False)
    posture = PlusPath(path("libero_goal", name)).posture
    env.reset()
    np.testing.assert_array_equal(env.sim.data.qpos[:7], posture)
    robot = env.robots[0]
    np.testing.assert_array_equal(robot.init_qpos, posture)
    np.testing.assert_array_equal(robot.controller.initial_joint, posture)
    turned = robot.controller.ee_ori_mat.copy()
    env.set_init_state(states("libero_goal", name)[0])
    for _ in range(60):
        env.step(NO_OP)
    # The controller keeps the orientation of the reset as its goal.
    angle = np.arccos((np.trace(turned.T @ env.robots[0].controller.ee_ori_mat) - 1) / 2)
    assert np.degrees(angle) < 0.5
    env.close()


def test_a_soft_reset_keeps_the_view() -> None:
    env = make(f"{BOWL}_view_0_0_181_0_0_initstate_0", use_camera_obs=False, hard_reset=False)
    camera = env.sim.model.camera_name2id("agentview")
    for _ in range(2):
        np.testing.assert_array_equal(env.sim.model.cam_pos[camera], [1.1921, 0.0, 2.2668])
        env.reset()
    env.close()


def test_every_path_has_a_rounded_view() -> None:
    # LIBERO-Plus rounds the camera's pose to four decimals, even if the path names no view.
    env = make(BOWL, use_camera_obs=False)
    camera = env.sim.model.camera_name2id("agentview")
    np.testing.assert_array_equal(env.sim.model.cam_pos[camera], [0.6586, 0.0, 1.6104])
    env.close()


def test_sim_render_draws_the_variants_view_without_corruption() -> None:
    nominal, far = make(BOWL), make(f"{BOWL}_view_0_0_181_0_0_initstate_0_noise_39")
    pictures = []
    for env in (nominal, far):
        env.seed(0)
        env.reset()
        picture = env.sim.render(32, 32, camera_name="agentview")
        np.testing.assert_array_equal(picture, env.env._get_observations()[IMAGE])
        pictures.append(picture)
        env.close()
    assert not np.array_equal(*pictures)


def test_a_camera_that_is_declared_unused_stays_black(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROLLOUT_UNUSED_CAMERAS", "agentview")
    env = make(FOG)
    before = np.random.get_state()[2]
    assert not env.reset()[IMAGE].any()
    assert np.random.get_state()[2] != before
    env.close()


def test_segmentations_are_of_uncorrupted_frames() -> None:
    numbers, frames = [], []
    for name in (FOG, f"{BOWL}_view_0_0_100_0_0_initstate_0_noise_0"):
        env = SegmentationRenderEnv(
            bddl_file_name=path("libero_goal", name), camera_heights=32, camera_widths=32
        )
        env.seed(1)
        env.reset()
        frames.append(env.step(NO_OP)[0][IMAGE])
        numbers.append(np.random.random_sample())
        assert "plate_1" in env.instance_to_id
        env.close()
    assert numbers[0] == numbers[1]
    np.testing.assert_array_equal(*frames)


def test_unavailable_variants_are_refused_with_the_remedy(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="scenes/lights/.*ROLLOUT_ASSETS"):
        make(f"{BOWL}_light_1")
    with pytest.raises(FileNotFoundError, match="new_objects/.*no package index"):
        make(f"{BOWL}_add_1")
    with pytest.raises(FileNotFoundError, match="no package index has.*ROLLOUT_ASSETS"):
        make(f"{BOWL}_table_1")
    with pytest.raises(ValueError, match="at most 256 pixels"):
        make(FOG, size=300)
    with pytest.raises(ValueError, match="0 to 500"):
        make(f"{BOWL}_view_0_0_100_0_0_initstate_501")
    with pytest.raises(FileNotFoundError, match="get_task_bddl_file_path"):
        make("none_view_0_0_100_0_0_initstate_1")
    with pytest.raises(ValueError, match="ROLLOUT_SOURCES"):
        plus.set_libero_default_path(str(tmp_path))


def test_further_files_of_a_folder_with_liberos_assets_are_used(
    real_assets: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "assets"
    shutil.copytree(real_assets, folder, copy_function=os.symlink)
    monkeypatch.setenv("ROLLOUT_ASSETS", str(folder))
    # This texture stands for the texture of the same name in LIBERO-Plus' archive.
    floor = folder / "textures" / "CarbonFiber001_COL_6K.png"
    floor.symlink_to(real_assets / "textures" / "brown_ceramic_tile.png")
    soup = "pick_up_the_alphabet_soup_and_place_it_in_the_basket"
    frames = []
    for name in (soup, f"{soup}_table_1"):
        env = make(name, "libero_object")
        env.seed(0)
        frames.append(env.reset()[IMAGE])
        env.close()
    assert not np.array_equal(*frames)
    with pytest.raises(FileNotFoundError, match="textures/.*ROLLOUT_ASSETS"):
        make(f"{soup}_table_10", "libero_object")
