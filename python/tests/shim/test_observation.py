"""Pictures of observations, drawn when they are read. However and whenever they are
read, copied or sent, they equal pictures that were drawn at once, bit for bit."""

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
READINGS: list[Callable[[Observation], dict[str, Any]]] = [
    dict,
    lambda seen: {**seen},
    lambda seen: dict(seen.items()),
    lambda seen: dict(zip(seen, seen.values())),
    lambda seen: {key: seen[key] for key in seen},
    lambda seen: {key: seen.get(key) for key in seen},
    lambda seen: {key: seen.setdefault(key) for key in seen},
    lambda seen: dict(reversed(list(reversed(seen.items())))),
    lambda seen: {key: seen.pop(key) for key in list(seen)},
    lambda seen: dict(reversed([seen.popitem() for _ in range(len(seen))])),
    lambda seen: dict(seen.popitem(last=False) for _ in range(len(seen))),
    lambda seen: dict(seen.copy()),
    lambda seen: dict(copy.copy(seen)),
    lambda seen: copy.deepcopy(seen),
    lambda seen: pickle.loads(pickle.dumps(seen)),
    lambda seen: pickle.loads(pickle.dumps(seen, protocol=2)),
    lambda seen: seen | {},
    lambda seen: {} | seen,
    lambda seen: OrderedDict(seen),
    lambda seen: (lambda **given: given)(**seen),
    lambda seen: _updated(seen),
    lambda seen: np.stack([seen])[0],
]


def _updated(seen: Observation) -> dict[str, Any]:
    other: dict[str, Any] = {}
    other.update(seen)
    return other


def construct(bddl_file: str, **arguments: Any) -> OffScreenRenderEnv:
    env = OffScreenRenderEnv(
        bddl_file_name=bddl_file, camera_heights=24, camera_widths=32, **arguments
    )
    env.seed(3)
    env.reset()
    return env


def undrawn(seen: Observation) -> list[str]:
    return [key for key in seen if type(OrderedDict.__getitem__(seen, key)) is Undrawn]


def actions(steps: int) -> np.ndarray:
    return np.random.default_rng(5).uniform(-1, 1, (steps, 7))


@pytest.mark.parametrize("number", range(len(READINGS)))
def test_lazy_observations_equal_those_drawn_at_once(number: int, bddl_file: str) -> None:
    env, eager = construct(bddl_file), construct(bddl_file)
    for action in actions(2):
        late, *_ = env.step(action)
        early, *_ = eager.step(action)
        early = OrderedDict((key, early[key]) for key in early)
    assert undrawn(late) == list(PICTURES)
    env.step(action)
    read = READINGS[number](late)
    assert list(read) == list(early)
    for key, array in early.items():
        assert type(read[key]) is type(array) is np.ndarray
        assert read[key].dtype == array.dtype and read[key].flags.writeable
        np.testing.assert_array_equal(read[key], array, err_msg=key)


def test_unread_observations_draw_nothing(bddl_file: str) -> None:
    size = {"camera_heights": 23, "camera_widths": 31}
    env = OffScreenRenderEnv(bddl_file_name=bddl_file, **size)
    # The scene's first observation through these cameras is drawn at once, to find errors early.
    assert undrawn(env.reset()) == []
    assert undrawn(env.reset()) == list(PICTURES)
    other = OffScreenRenderEnv(bddl_file_name=bddl_file, **size)
    assert undrawn(other.reset()) == list(PICTURES)
    other.close()
    large = OffScreenRenderEnv(bddl_file_name=bddl_file, camera_heights=5000)
    with pytest.raises(ValueError, match="each side may have 1 to 4096"):
        large.reset()
    large.close()
    seen, *_ = env.step(actions(1)[0])
    assert len(seen) > 20 and "agentview_image" in seen
    assert seen["agentview_image"] is seen["agentview_image"]
    assert undrawn(seen) == ["robot0_eye_in_hand_image"]
    env.close()


def test_an_unused_camera_is_black_and_the_other_is_unchanged(
    bddl_file: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = {"camera_depths": True, "camera_segmentations": "instance"}
    env = construct(bddl_file, **asked)
    expected = dict(env.step(actions(1)[0])[0])
    env.close()
    monkeypatch.setattr(_unused, "_said", set())
    monkeypatch.setenv("ROLLOUT_UNUSED_CAMERAS", " robot0_eye_in_hand,")
    env = construct(bddl_file, **asked)
    seen = dict(env.step(actions(1)[0])[0])
    assert list(seen) == list(expected)
    for key, array in expected.items():
        assert (seen[key].shape, seen[key].dtype) == (array.shape, array.dtype), key
        if key.startswith("robot0_eye_in_hand_"):
            array = np.zeros_like(array)
        np.testing.assert_array_equal(seen[key], array, err_msg=key)
    picture = env.sim.render(32, 24, camera_name="robot0_eye_in_hand")
    assert picture.any(), "to ask for a picture is to use the camera"
    env.close()
    construct(bddl_file).close()
    said = capsys.readouterr().err
    assert said.count("robot0_eye_in_hand: its frames are black") == 1, said
    monkeypatch.setenv("ROLLOUT_UNUSED_CAMERAS", "wrist")
    with pytest.raises(ValueError, match="no such camera: choose of .*agentview"):
        construct(bddl_file)


@pytest.mark.parametrize("seed", range(4))
def test_pictures_read_in_any_order_are_those_drawn_at_once(seed: int, bddl_file: str) -> None:
    chance = random.Random(seed)
    env, eager = construct(bddl_file), construct(bddl_file)
    states = benchmark.get_benchmark("libero_goal")().get_task_init_states(8)
    kept: list[tuple[Observation, dict[str, Any]]] = []
    steps = iter(actions(40))

    def moved(env: OffScreenRenderEnv, what: str, value: Any) -> Observation:
        if what == "reset":
            env.seed(value)
            return env.reset()
        if what == "state":
            return env.set_init_state(states[value])
        if what == "camera":
            positions = env.sim.model.cam_pos.copy()
            env.sim.model.set("cam_pos", positions + [0, 0, value / 50])
            return env.env._get_observations()
        if what == "stove":
            colours = env.sim.model.site_rgba.copy()
            env.sim.model.set("site_rgba", 1 - colours)
        return env.step(value)[0]

    for _ in range(40):
        what = chance.choice(["step"] * 5 + ["reset", "state", "camera", "stove"])
        value = next(steps) if what in ("step", "stove") else chance.randrange(50)
        late, early = (moved(environment, what, value) for environment in (env, eager))
        kept.append((late, dict(early)))
        while kept and chance.random() < 0.4:
            late, early = kept[chance.randrange(len(kept))]
            key = chance.choice(PICTURES)
            np.testing.assert_array_equal(late[key], early[key])
        if chance.random() < 0.2:
            # Dropping an observation without reading it does no harm.
            kept.pop(chance.randrange(len(kept))) if kept else None
            gc.collect()
    chance.shuffle(kept)
    for late, early in kept:
        for key in late:
            np.testing.assert_array_equal(late[key], early[key])
    # Reading pictures has not changed the state.
    np.testing.assert_array_equal(env.get_sim_state(), eager.get_sim_state())
    for environment in (env, eager):
        environment.close()


def test_two_observations_of_one_instant_share_their_pictures(bddl_file: str) -> None:
    env = construct(bddl_file)
    env.step(actions(1)[0])
    one, other = (env.env._get_observations() for _ in range(2))
    assert one["agentview_image"] is other["agentview_image"]
    # A change of one observation does not affect the next step's.
    one["agentview_image"][:] = 0
    after, *_ = env.step(actions(1)[0])
    assert after["agentview_image"].any()
    env.close()


def test_observations_are_compared_by_their_pictures(bddl_file: str) -> None:
    env = construct(bddl_file)
    one, *_ = env.step(actions(1)[0])
    assert one == one and not one != one
    scalars = Observation({"at": Undrawn(lambda: np.float64(3.0)), "then": 1})  # type: ignore[arg-type,return-value]
    assert scalars == {"then": 1, "at": 3.0} and {"then": 1, "at": 3.0} == scalars
    assert scalars != {"then": 1, "at": 4.0}
    assert "Undrawn" not in repr(one)
    with pytest.raises(TypeError):
        hash(one)
    env.close()


def test_a_picture_is_drawn_while_its_environment_is_busy_or_closed(
    bddl_file: str,
) -> None:
    env, eager = construct(bddl_file), construct(bddl_file)
    action = actions(1)[0]
    expected = dict(eager.step(action)[0])
    late, *_ = env.step(action)
    look = env.env._held.get().look()

    failed: list[Exception] = []

    def compute() -> None:
        try:
            for _ in range(60):
                env.step(action)
        except Exception as error:  # noqa: BLE001
            failed.append(error)

    thread = threading.Thread(target=compute)
    thread.start()
    np.testing.assert_array_equal(late["agentview_image"], expected["agentview_image"])
    while thread.is_alive():
        # Drawn again each time from the recorded poses.
        np.testing.assert_array_equal(
            look.frame("agentview", 32, 24), expected["agentview_image"]
        )
    thread.join()
    # Drawing does not block the other thread.
    assert failed == []
    env.close()
    np.testing.assert_array_equal(
        late["robot0_eye_in_hand_image"], expected["robot0_eye_in_hand_image"]
    )


def test_depths_and_segmentations_are_drawn_late_too(bddl_file: str) -> None:
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

    env, eager = make(), make()
    kept = []
    for action in actions(4):
        kept.append((env.step(action)[0], dict(eager.step(action)[0])))
    assert len(undrawn(kept[0][0])) == 8
    for late, early in reversed(kept):
        for key in reversed(early):
            np.testing.assert_array_equal(late[key], early[key], err_msg=key)
    for environment in (env, eager):
        environment.close()
