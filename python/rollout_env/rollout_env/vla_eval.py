"""vla-eval's benchmarks, by their universal interface."""

from __future__ import annotations

import asyncio
import importlib
from collections.abc import Coroutine
from typing import Any

import numpy as np

from .description import Camera, Description, Observation, Step, Task, Unusable
from .packages import driver, loaded
from .settings import Settings

#: Formats of vla-eval whose numbers have a meaning for the actuation axis.
MEANINGS = {
    "delta_xyz": ["x", "y", "z"],
    "euler_xyz": ["roll", "pitch", "yaw"],
    "axis_angle": ["roll", "pitch", "yaw"],
}
#: Seed of the episode that is described.
SEED = 0


class VlaEvalSimulator:
    """Constructs a benchmark for each rollout; a seed is vla-eval's `episode_idx`."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._loop = asyncio.new_event_loop()
        self._benchmark: Any = None
        self._construct()
        benchmark: Any = self._benchmark
        known = {str(task["name"]): task for task in benchmark.get_tasks()}
        names = settings.tasks or list(known)
        unknown = [name for name in names if name not in known]
        if unknown or not names:
            raise Unusable(f"`{settings.spec}` has no task `{unknown}`, but {', '.join(known)}")
        self._begin(names[0], SEED)
        steps = settings.max_steps or benchmark.get_metadata().get("max_steps")
        rate = settings.control_hz or getattr(benchmark, "frequency", 0)
        if not steps or not rate:
            option = "--control-hz" if steps else "--max-steps"
            raise Unusable(f"`{settings.spec}` does not say it: name it with {option}")
        spec = benchmark.get_action_spec()
        parts = list(spec.values()) if isinstance(spec, dict) else []
        # A range for each number; the pipe's numbers are in −1 to 1.
        self._ranges = [part.range or (-1.0, 1.0) for part in parts for _ in range(part.dims)]
        meanings = [_meaning(part) for part in parts]
        action = settings.action or [word for words in meanings for word in words]
        # A benchmark that declares no numbers, `RAW`, takes what --action names.
        self._ranges = self._ranges or [(-1.0, 1.0)] * len(action)
        if len(action) != len(self._ranges):
            raise Unusable(
                f"--action names {len(action)} numbers, but `{settings.spec}` declares "
                f"{len(self._ranges)}"
            )
        seen = self._observed()
        self.description = Description(
            name=settings.spec,
            tasks=[
                Task(name, settings.instructions.get(name, self._instruction(name)), int(steps))
                for name in names
            ],
            cameras=[
                Camera(name, frame.shape[1], frame.shape[0]) for name, frame in seen.frames.items()
            ],
            state={name: len(reading) for name, reading in seen.state.items()},
            action=action,
            control_hz=float(rate),
            axes=[],
            packages=loaded(),
            driver=driver(),
        )

    def _construct(self) -> None:
        self.close()
        module, _, name = self._settings.name.rpartition(":")
        try:
            create = getattr(importlib.import_module(module), name)
            self._benchmark = create(**self._settings.keywords)
        except ImportError as error:
            raise Unusable(
                f"`{self._settings.spec}` needs a package: {error}. Install it beside this "
                "interpreter, or start rollout-env with the interpreter that has it"
            ) from error
        except Exception as error:
            raise Unusable(f"constructing `{self._settings.spec}`: {error!r}") from error

    def _begin(self, task: str, seed: int) -> None:
        (chosen,) = [one for one in self._benchmark.get_tasks() if str(one["name"]) == task]
        self._run(self._benchmark.start_episode({**chosen, "episode_idx": seed}))

    def reset(self, task: str, seed: int, perturb: dict[str, Any]) -> None:
        """Starts an episode in a new benchmark."""
        self._construct()
        self._begin(task, seed)

    def step(self, action: np.ndarray) -> Step:
        """Executes an action, whose numbers are −1 to 1 between the ends of vla-eval's ranges."""
        low, high = np.array(self._ranges).T
        scaled = ((low + high) / 2 + action * ((high - low) / 2)).astype(np.float32)
        self._run(self._benchmark.apply_action({"actions": scaled}))
        ended = bool(self._run(self._benchmark.is_done()))
        success = ended and bool(self._run(self._benchmark.get_result())["success"])
        return Step(success, ended)

    def observe(self, cameras: list[Camera]) -> Observation:
        """Returns the frames of these cameras, and the readings."""
        seen = self._observed()
        frames = {camera.name: seen.frames[camera.name] for camera in cameras}
        return Observation(frames, seen.state, seen.whole)

    def _observed(self) -> Observation:
        observed = self._run(self._benchmark.get_observation())
        sources = self._settings.cameras
        frames = {name: np.asarray(frame) for name, frame in observed["images"].items()}
        frames = {name: frames[key] for name, key in sources.items()} if sources else frames
        readings = {
            key: np.asarray(value, dtype=np.float64).reshape(-1)
            for key, value in observed.items()
            if key not in ("images", "task_description") and not isinstance(value, str)
        }
        return Observation(frames, readings, readings)

    def _instruction(self, name: str) -> str:
        observed = self._run(self._benchmark.get_observation())
        single = len(self._settings.tasks) == 1
        return str(observed.get("task_description", name)) if single else name

    def _run(self, call: Coroutine[Any, Any, Any]) -> Any:
        return self._loop.run_until_complete(call)

    def close(self) -> None:
        """Releases the benchmark's environments."""
        if self._benchmark is not None:
            benchmark, self._benchmark = self._benchmark, None
            benchmark.cleanup()


def _meaning(part: Any) -> list[str]:
    if part.name == "gripper" and part.dims == 1:
        return ["gripper"]
    words = MEANINGS.get(part.format, [])
    return words if len(words) == part.dims else [""] * part.dims
