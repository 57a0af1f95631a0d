"""Conformance of an environment: what campaigns rely on, and the remedy where it does not hold."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from .description import Failed, Observation, Simulator, Unusable, check_observation

#: Control steps of each comparison.
STEPS = 20
#: Seeds of the compared rollouts.
SEEDS = (7, 8)


@dataclass(frozen=True)
class Finding:
    """A deviation. An error makes results wrong; a note limits what a campaign can ask."""

    is_error: bool
    name: str
    text: str


def check(make: Callable[[], Simulator], task: str = "") -> Iterator[Finding]:
    """Yields what is wrong with an environment; `make` constructs its simulator."""
    try:
        simulator = make()
        about = simulator.description
        yield from _declared(simulator)
        task = task or about.tasks[0].name
        first = _rollout(simulator, task, SEEDS[0])
        again = _rollout(simulator, task, SEEDS[0])
        other = _rollout(simulator, task, SEEDS[1])
        simulator.close()
    except (Unusable, Failed) as error:
        yield Finding(True, type(error).__name__.lower(), str(error))
        return
    except Exception as error:
        yield Finding(True, "raised", f"it raised {error!r}: correct the environment")
        return
    for was, now, when in ((first[0], again[0], "reset"), (first[-1], again[-1], "step")):
        state, frames = _differing(was, now)
        if state:
            yield Finding(
                True,
                f"non-deterministic {when}",
                f"{when} with one seed and the same actions led to "
                f"different values of {', '.join(state)}: draw all randomness from the seed of "
                "`reset`, or of construction; results are paired by seed only, so measure a "
                "placebo level",
            )
            break
        if frames:
            yield Finding(
                True,
                "unrepeatable frames",
                f"the values repeat, but the frames of {', '.join(frames)} do not: set threads "
                "and clocks aside when drawing",
            )
            break
    if first[0].digest() == other[0].digest():
        yield Finding(
            True,
            "unseeded reset",
            f"seeds {SEEDS[0]} and {SEEDS[1]} give the same first observation: pass the seed on to "
            "what draws the initial state, or every rollout of a task starts alike",
        )
    if first[0].digest() == first[1].digest():
        yield Finding(
            True,
            "frames or readings that do not move",
            f"{STEPS} steps with actions of the whole range change nothing: return the state after "
            "the step",
        )


def _declared(simulator: Simulator) -> Iterator[Finding]:
    about = simulator.description
    if not about.cameras:
        yield Finding(
            False,
            "no camera",
            "policies see readings only: name one with `--camera agentview=mujoco.CAMERA`, "
            "`=render` or a key of the observation",
        )
    if not all(about.action):
        count = sum(not word for word in about.action)
        yield Finding(
            False,
            "unnamed actions",
            f"{count} of {len(about.action)} numbers of an action have no meaning, so the "
            "actuation axis is refused: name them with --action",
        )
    if not 1 <= about.control_hz <= 1000:
        yield Finding(
            True,
            "control rate",
            f"{about.control_hz} control steps a second: correct it with --control-hz",
        )


def _rollout(simulator: Simulator, task: str, seed: int) -> list[Observation]:
    """Returns the first and the last observation of a short rollout of fixed actions."""
    about = simulator.description
    simulator.reset(task, seed, {})
    actions = np.random.default_rng(0).uniform(-1, 1, (STEPS, len(about.action)))
    seen = [_observed(simulator, "before the first step")]
    for action in actions:
        step = simulator.step(action)
        check_observation(about, [], simulator.observe([]))
        if step.ended or step.success:
            break
    seen.append(_observed(simulator, "after the last step"))
    return seen


def _observed(simulator: Simulator, when: str) -> Observation:
    """Observes twice: nothing may change without a step."""
    cameras = simulator.description.cameras
    seen = simulator.observe(cameras)
    check_observation(simulator.description, cameras, seen)
    state, frames = _differing(seen, simulator.observe(cameras))
    if state or frames:
        raise Failed(
            f"{when}, two observations differ in {', '.join(state + frames)} though no step was "
            "made: stop the simulation between steps"
        )
    return seen


def _differing(was: Observation, now: Observation) -> tuple[list[str], list[str]]:
    """Returns the readings and the cameras that differ."""

    def names(left: dict[str, np.ndarray], right: dict[str, np.ndarray]) -> list[str]:
        return [name for name in left if not np.array_equal(left[name], right[name])]

    return names(was.whole, now.whole), names(was.frames, now.frames)
