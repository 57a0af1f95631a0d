"""Pictures of observations are drawn when they are read. However and whenever an observation is
read, copied or sent, its pictures equal pictures drawn at once, bit for bit."""

from __future__ import annotations

import copy
import gc
import pickle
import random
import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from libero.libero import benchmark
from libero.libero.envs import OffScreenRenderEnv, SegmentationRenderEnv, _unused
from libero.libero.envs._lazy import Observation, Undrawn

PICTURES = ("agentview_image", "robot0_eye_in_hand_image")
#: Ways to read all entries of an observation.
READINGS: list[Callable[[Observation], dict[str, Any]]] = [
    dict,
    lambda observation: {**observation},
    lambda observation: dict(observation.items()),
    lambda observation: dict(zip(observation, observation.values())),
    lambda observation: {key: observation[key] for key in observation},
    lambda observation: {key: observation.get(key) for key in observation},
    lambda observation: {key: observation.setdefault(key) for key in observation},
    lambda observation: dict(reversed(list(reversed(observation.items())))),
    lambda observation: {key: observation.pop(key) for key in list(observation)},
    lambda observation: dict(reversed([observation.popitem() for _ in range(len(observation))])),
    lambda observation: dict(observation.popitem(last=False) for _ in range(len(observation))),
    lambda observation: dict(observation.copy()),
    lambda observation: dict(copy.copy(observation)),
    lambda observation: copy.deepcopy(observation),
    lambda observation: pickle.loads(pickle.dumps(observation)),
    lambda observation: pickle.loads(pickle.dumps(observation, protocol=2)),
    lambda observation: observation | {},
    lambda observation: {} | observation,
    lambda observation: OrderedDict(observation),
    lambda observation: (lambda **entries: entries)(**observation),
    lambda observation: _updated(observation),
    lambda observation: np.stack([observation])[0],
]


def _updated(observation: Observation) -> dict[str, Any]:
    entries: dict[str, Any] = {}
    entries.update(observation)
    return entries


def construct(bddl_file: str, **arguments: Any) -> OffScreenRenderEnv:
    env = OffScreenRenderEnv(
        bddl_file_name=bddl_file, camera_heights=24, camera_widths=32, **arguments
    )
    env.seed(3)
    env.reset()
    return env


def unrendered(observation: Observation) -> list[str]:
    values = {key: OrderedDict.__getitem__(observation, key) for key in observation}
    return [key for key, value in values.items() if type(value) is Undrawn]


def actions(steps: int) -> np.ndarray:
    return np.random.default_rng(5).uniform(-1, 1, (steps, 7))


@pytest.mark.parametrize("number", range(len(READINGS)))
def test_lazy_observations_equal_those_drawn_at_once(number: int, bddl_file: str) -> None:
    env, eager_env = construct(bddl_file), construct(bddl_file)
    for action in actions(2):
        lazy, *_ = env.step(action)
        drawn, *_ = eager_env.step(action)
        drawn = OrderedDict((key, drawn[key]) for key in drawn)
    assert unrendered(lazy) == list(PICTURES)
    env.step(action)
    read = READINGS[number](lazy)
    assert list(read) == list(drawn)
    for key, array in drawn.items():
        assert type(read[key]) is type(array) is np.ndarray
        assert read[key].dtype == array.dtype and read[key].flags.writeable
        np.testing.assert_array_equal(read[key], array, err_msg=key)


def test_unread_observations_render_no_pictures(bddl_file: str) -> None:
    size = {"camera_heights": 23, "camera_widths": 31}
    env = OffScreenRenderEnv(bddl_file_name=bddl_file, **size)
    # The scene's first observation with cameras of this size is drawn at once, to detect errors
    # early.
    assert unrendered(env.reset()) == []
    assert unrendered(env.reset()) == list(PICTURES)
    other = OffScreenRenderEnv(bddl_file_name=bddl_file, **size)
    assert unrendered(other.reset()) == list(PICTURES)
    other.close()
    large = OffScreenRenderEnv(bddl_file_name=bddl_file, camera_heights=5000)
    with pytest.raises(ValueError, match="each side may have 1 to 4096"):
        large.reset()
    large.close()
    observation, *_ = env.step(actions(1)[0])
    assert len(observation) > 20 and "agentview_image" in observation
    assert observation["agentview_image"] is observation["agentview_image"]
    assert unrendered(observation) == ["robot0_eye_in_hand_image"]
    env.close()


def test_an_unused_camera_is_black_and_the_other_is_unchanged(
    bddl_file: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    options = {"camera_depths": True, "camera_segmentations": "instance"}
    env = construct(bddl_file, **options)
    expected = dict(env.step(actions(1)[0])[0])
    env.close()
    monkeypatch.setattr(_unused, "_warned", set())
    monkeypatch.setenv("ROLLOUT_UNUSED_CAMERAS", " robot0_eye_in_hand,")
    env = construct(bddl_file, **options)
    observation = dict(env.step(actions(1)[0])[0])
    assert list(observation) == list(expected)
    for key, array in expected.items():
        assert (observation[key].shape, observation[key].dtype) == (array.shape, array.dtype), key
        if key.startswith("robot0_eye_in_hand_"):
            array = np.zeros_like(array)
        np.testing.assert_array_equal(observation[key], array, err_msg=key)
    picture = env.sim.render(32, 24, camera_name="robot0_eye_in_hand")
    assert picture.any(), "`sim.render` renders an unused camera, too"
    env.close()
    construct(bddl_file).close()
    printed = capsys.readouterr().err
    assert printed.count("robot0_eye_in_hand: its frames are black") == 1, printed
    monkeypatch.setenv("ROLLOUT_UNUSED_CAMERAS", "wrist")
    with pytest.raises(ValueError, match="no such camera: choose from .*agentview"):
        construct(bddl_file)


@pytest.mark.parametrize("seed", range(4))
def test_pictures_read_in_any_order_are_those_drawn_at_once(seed: int, bddl_file: str) -> None:
    rng = random.Random(seed)
    env, eager_env = construct(bddl_file), construct(bddl_file)
    states = benchmark.get_benchmark("libero_goal")().get_task_init_states(8)
    pairs: list[tuple[Observation, dict[str, Any]]] = []
    steps = iter(actions(40))

    def apply_change(env: OffScreenRenderEnv, change: str, value: Any) -> Observation:
        if change == "reset":
            env.seed(value)
            return env.reset()
        if change == "state":
            return env.set_init_state(states[value])
        if change == "camera":
            positions = env.sim.model.cam_pos.copy()
            env.sim.model.set("cam_pos", positions + [0, 0, value / 50])
            return env.env._get_observations()
        if change == "stove":
            colours = env.sim.model.site_rgba.copy()
            env.sim.model.set("site_rgba", 1 - colours)
        return env.step(value)[0]

    for _ in range(40):
        change = rng.choice(["step"] * 5 + ["reset", "state", "camera", "stove"])
        value = next(steps) if change in ("step", "stove") else rng.randrange(50)
        lazy, drawn = (apply_change(environment, change, value) for environment in (env, eager_env))
        pairs.append((lazy, dict(drawn)))
        while pairs and rng.random() < 0.4:
            lazy, drawn = pairs[rng.randrange(len(pairs))]
            key = rng.choice(PICTURES)
            np.testing.assert_array_equal(lazy[key], drawn[key])
        if rng.random() < 0.2:
            # An observation may be dropped unread.
            pairs.pop(rng.randrange(len(pairs))) if pairs else None
            gc.collect()
    rng.shuffle(pairs)
    for lazy, drawn in pairs:
        for key in lazy:
            np.testing.assert_array_equal(lazy[key], drawn[key])
    # Reading pictures has not changed the state.
    np.testing.assert_array_equal(env.get_sim_state(), eager_env.get_sim_state())
    for environment in (env, eager_env):
        environment.close()


def test_two_observations_of_one_instant_share_their_pictures(bddl_file: str) -> None:
    env = construct(bddl_file)
    env.step(actions(1)[0])
    first, second = (env.env._get_observations() for _ in range(2))
    assert first["agentview_image"] is second["agentview_image"]
    # A change of an observation's picture does not affect the observation of the next step.
    first["agentview_image"][:] = 0
    after, *_ = env.step(actions(1)[0])
    assert after["agentview_image"].any()
    env.close()


def test_observations_are_compared_by_their_pictures(bddl_file: str) -> None:
    env = construct(bddl_file)
    observation, *_ = env.step(actions(1)[0])
    assert observation == observation and not observation != observation
    scalars = Observation({"a": Undrawn(lambda: np.float64(3.0)), "b": 1})  # type: ignore[arg-type,return-value]
    assert scalars == {"b": 1, "a": 3.0} and {"b": 1, "a": 3.0} == scalars
    assert scalars != {"b": 1, "a": 4.0}
    assert "Undrawn" not in repr(observation)
    with pytest.raises(TypeError):
        hash(observation)
    env.close()


def test_a_picture_is_drawn_while_its_environment_is_busy_or_closed(bddl_file: str) -> None:
    env, eager_env = construct(bddl_file), construct(bddl_file)
    action = actions(1)[0]
    expected = dict(eager_env.step(action)[0])
    lazy, *_ = env.step(action)
    view = env.env._handle.get().capture()

    failed: list[Exception] = []

    def compute() -> None:
        try:
            for _ in range(60):
                env.step(action)
        except Exception as error:  # noqa: BLE001
            failed.append(error)

    thread = threading.Thread(target=compute)
    thread.start()
    np.testing.assert_array_equal(lazy["agentview_image"], expected["agentview_image"])
    while thread.is_alive():
        # Each call draws the picture again from the recorded poses.
        np.testing.assert_array_equal(view.frame("agentview", 32, 24), expected["agentview_image"])
    thread.join()
    # Drawing does not block the other thread.
    assert failed == []
    env.close()
    np.testing.assert_array_equal(
        lazy["robot0_eye_in_hand_image"], expected["robot0_eye_in_hand_image"]
    )


def test_depths_and_segmentations_are_rendered_when_read_too(bddl_file: str) -> None:
    def make() -> SegmentationRenderEnv:
        env = SegmentationRenderEnv(
            bddl_file_name=bddl_file,
            camera_segmentations=["instance", "element"],
            camera_depths=True,
            camera_heights=24,
            camera_widths=32,
        )
        env.seed(1)
        env.reset()
        return env

    env, eager_env = make(), make()
    pairs = []
    for action in actions(4):
        pairs.append((env.step(action)[0], dict(eager_env.step(action)[0])))
    # Picture, depth and two segmentations of each of two cameras.
    assert len(unrendered(pairs[0][0])) == 8
    for lazy, drawn in reversed(pairs):
        for key in reversed(drawn):
            np.testing.assert_array_equal(lazy[key], drawn[key], err_msg=key)
    for environment in (env, eager_env):
        environment.close()
