"""gymnasium's environments, and LeRobot's, which speak gymnasium."""

from __future__ import annotations

import importlib.util
import inspect
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from .description import Camera, Description, Failed, Observation, Step, Task, Unusable
from .packages import driver, loaded
from .settings import Settings

#: Keys of `info` that report success, by gymnasium's and LeRobot's conventions.
SUCCESS = ("is_success", "success")
#: Attributes with a task's instruction, in the order of preference.
INSTRUCTION = ("task_description", "language_instruction")
#: Prefix of a camera that this package draws from MuJoCo's model.
MUJOCO = "mujoco."
#: Seed of the environment that is described; any other would do.
SEED = 0


class GymSimulator:
    """Constructs an environment for each rollout, or reuses that of a task whose resets repeat."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._env: Any = None
        self._task = ""
        #: Tasks by the outcome of the test whether a second reset equals the first.
        self._repeats: dict[str, bool] = {}
        self._renderers: dict[tuple[int, int], Any] = {}
        self._observed: dict[str, np.ndarray] = {}
        self.description = self._describe()

    def _describe(self) -> Description:
        settings = self._settings
        names = settings.tasks or [re.split(r"[/:]", settings.name.removesuffix("()"))[-1]]
        self._construct(names[0], SEED)
        self._begin(SEED, {})
        env = self._env
        low = getattr(env.action_space, "low", None)
        if low is None or low.ndim != 1:
            raise Unusable(
                f"the action space of `{settings.spec}` is {env.action_space}: wrap the "
                "environment, so that it takes one Box of one dimension"
            )
        action = settings.action or [""] * len(low)
        if len(action) != len(low):
            raise Unusable(f"--action names {len(action)} numbers, an action has {len(low)}")
        pictures = {_leaf(key): key for key, value in self._observed.items() if _is_picture(value)}
        if not pictures and getattr(env, "render_mode", None) == "rgb_array":
            pictures = {"render": "render"}
        self._cameras = settings.cameras or pictures
        readings = {key: value for key, value in self._observed.items() if value.ndim < 2}
        self._state = settings.state or {_leaf(key): key for key in readings}
        metadata = getattr(env, "metadata", None) or {}
        rate = settings.control_hz or metadata.get("render_fps")
        if not rate:
            raise Unusable(f"`{settings.spec}` has no control rate: name it with --control-hz")
        described = Description(
            name=settings.spec,
            tasks=[],
            cameras=[self._camera(name, source) for name, source in self._cameras.items()],
            state={name: len(self._reading(source)) for name, source in self._state.items()},
            action=list(action),
            control_hz=float(rate),
            axes=list(metadata.get("perturb", [])),
        )
        if settings.reuse:
            described = replace(described, reused=self._can_reuse(names[0], described))
        tasks: list[Task] = []
        for name in names:
            # Only an environment that has instructions is constructed for each task to ask for its.
            if tasks and _attribute(self._env, INSTRUCTION):
                self._construct(name, SEED)
            tasks.append(self._about(name))
        return replace(described, tasks=tasks, packages=loaded(), driver=driver())

    def _about(self, task: str) -> Task:
        words = re.sub(r"[-_]+", " ", re.sub(r"-?v\d+$", "", task))
        words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", words).lower()
        instruction = self._settings.instructions.get(task) or _attribute(self._env, INSTRUCTION)
        steps = self._settings.max_steps or _attribute(
            self._env, ("_max_episode_steps", "max_path_length")
        )
        if not steps:
            raise Unusable(f"`{self._settings.spec}` has no time limit: name it with --max-steps")
        return Task(task, str(instruction or words), int(steps))

    def reset(self, task: str, seed: int, perturb: dict[str, Any]) -> None:
        """Starts a rollout in an environment as if it was constructed for it."""
        reuses = self.description.reused and self._task == task
        if not (reuses and self._can_reuse(task, self.description)):
            self._construct(task, seed)
        self._begin(seed, perturb)

    def _begin(self, seed: int, perturb: dict[str, Any]) -> None:
        options = {"perturb": perturb} if perturb else None
        observation, _ = self._env.reset(seed=seed, options=options)
        self._observed = dict(_leaves(observation))

    def _can_reuse(self, task: str, about: Description) -> bool:
        """Returns true if a second reset and a step look as in a new environment."""
        if task not in self._repeats:
            digests = []
            # The first is constructed with another seed, as a reused environment would be.
            for constructed_with in (SEED + 1, None, SEED):
                if constructed_with is not None:
                    self._construct(task, constructed_with)
                self._begin(SEED, {})
                first = self.observe(about.cameras).digest()
                self.step(np.zeros(len(about.action)))
                digests.append((first, self.observe(about.cameras).digest()))
            self._repeats[task] = len(set(digests)) == 1
        return self._repeats[task]

    def step(self, action: np.ndarray) -> Step:
        """Executes an action, whose numbers are −1 to 1 between the bounds of the space."""
        space = self._env.action_space
        bounded = np.isfinite(space.low) & np.isfinite(space.high)
        low, high = np.where(bounded, space.low, -1.0), np.where(bounded, space.high, 1.0)
        scaled = (low + high) / 2 + action * ((high - low) / 2)
        observation, _, ended, truncated, info = self._env.step(scaled.astype(space.dtype))
        self._observed = dict(_leaves(observation))
        ended = bool(_array(ended).any())
        if self._settings.success == "terminated":
            return Step(ended, ended or bool(_array(truncated).any()))
        keys = (self._settings.success,) if self._settings.success else SUCCESS
        for key in keys:
            if key in info:
                return Step(bool(_array(info[key]).any()), ended or bool(_array(truncated).any()))
        raise Failed(
            f"`info` of a step has none of {', '.join(keys)}, but {', '.join(info) or 'nothing'}: "
            "name the key that reports success with --success"
        )

    def observe(self, cameras: list[Camera]) -> Observation:
        """Returns the frames of these cameras, and the readings."""
        frames = {
            camera.name: self._frame(self._cameras[camera.name], camera.width, camera.height)
            for camera in cameras
        }
        state = {name: self._reading(source) for name, source in self._state.items()}
        return Observation(frames, state, self._observed)

    def _frame(self, source: str, width: int, height: int) -> np.ndarray:
        if source == "render":
            frame = self._env.render()
            if frame is None:
                raise Unusable(
                    f"`{self._settings.spec}` draws nothing: construct it with "
                    "`--set render_mode=rgb_array`"
                )
            return _array(frame)
        if source.startswith(MUJOCO):
            return self._drawn(source.removeprefix(MUJOCO), width, height)
        return self._value(source, "--camera")

    def _drawn(self, camera: str, width: int, height: int) -> np.ndarray:
        import mujoco

        model, data = _model_and_data(self._env, self._settings.spec)
        renderer = self._renderers.get((width, height))
        if renderer is None:
            renderer = self._renderers[width, height] = mujoco.Renderer(model, height, width)
        # A number is a camera's index; -1 is the free camera, which every model has.
        renderer.update_scene(data, int(camera) if re.fullmatch(r"-?\d+", camera) else camera)
        return renderer.render().copy()

    def _camera(self, name: str, source: str) -> Camera:
        width, height = self._settings.size
        try:
            height, width = self._frame(source, width, height).shape[:2]
        except (Unusable, Failed):
            raise
        except Exception as error:
            raise Unusable(f"drawing camera `{name}`, {source}, raised {error!r}") from error
        return Camera(name, width, height, source.startswith(MUJOCO))

    def _reading(self, source: str) -> np.ndarray:
        key, _, part = source.partition("[")
        values = np.asarray(self._value(key, "--state"), dtype=np.float64).reshape(-1)
        if not part:
            return values
        ends = [int(end) if end else None for end in part.rstrip("]").split(":")]
        return values[slice(*ends)]

    def _value(self, key: str, option: str) -> np.ndarray:
        if key not in self._observed:
            raise Unusable(
                f"the observation has no `{key}`, but {', '.join(self._observed)}: name one of "
                f"them with {option}"
            )
        return self._observed[key]

    def _construct(self, task: str, seed: int) -> None:
        self.close()
        settings = self._settings
        keywords = dict(settings.keywords)
        if settings.task_keyword:
            keywords[settings.task_keyword] = task
        if "render" in settings.cameras.values() and not settings.name.endswith("()"):
            keywords.setdefault("render_mode", "rgb_array")
        make = _lerobot if settings.kind == "lerobot" else _gymnasium
        try:
            self._env, self._task = make(settings.name, keywords, seed), task
        except Unusable:
            raise
        except ImportError as error:
            raise Unusable(
                f"`{settings.spec}` needs a package: {error}. Install it beside this interpreter, "
                "or start rollout-env with the interpreter that has it"
            ) from error
        except Exception as error:
            raise Unusable(f"constructing `{settings.spec}` with {keywords}: {error!r}") from error

    def close(self) -> None:
        """Closes the environment and what draws it."""
        for renderer in self._renderers.values():
            renderer.close()
        self._renderers.clear()
        if self._env is not None:
            env, self._env = self._env, None
            env.close()


def _gymnasium(name: str, keywords: dict[str, Any], seed: int) -> Any:
    """Makes an environment of gymnasium's registry, or one that a function returns."""
    import gymnasium
    from gymnasium.envs.registration import load_env_creator

    module, _, name = name.rpartition(":")
    # A package that registers its environments has the name of their namespace.
    package = module or name.split("/")[0].replace("-", "").lower()
    if module or importlib.util.find_spec(package):
        importlib.import_module(package)
    if name.endswith("()"):
        create = getattr(importlib.import_module(module), name.removesuffix("()"))
        return create(**_seeded(create, keywords, seed))
    create = gymnasium.spec(name).entry_point
    create = load_env_creator(create) if isinstance(create, str) else create
    return gymnasium.make(name, disable_env_checker=True, **_seeded(create, keywords, seed))


def _seeded(create: Any, keywords: dict[str, Any], seed: int) -> dict[str, Any]:
    """Adds the seed for environments that draw during construction."""
    takes_seed = "seed" in inspect.signature(create).parameters
    return {"seed": seed, **keywords} if takes_seed else keywords


def _lerobot(name: str, keywords: dict[str, Any], seed: int) -> Any:
    """Makes the single environment of LeRobot's factory."""
    from lerobot.envs.factory import make_env, make_env_config

    kind, _, task = name.partition("/")
    config = make_env_config(kind, **({"task": task} if task else {}), **keywords)
    vectors = [one for suite in make_env(config, n_envs=1).values() for one in suite.values()]
    if len(vectors) != 1:
        raise Unusable(f"`lerobot:{name}` is {len(vectors)} tasks: name one, lerobot:TYPE/TASK")
    return vectors[0].envs[0]


def _model_and_data(env: Any, spec: str) -> tuple[Any, Any]:
    """Returns MuJoCo's model and data of a gymnasium, robosuite or dm_control environment."""
    inner = env.unwrapped
    getters: list[Callable[[], tuple[Any, Any]]] = [
        lambda: (inner.model, inner.data),
        lambda: (inner.sim.model._model, inner.sim.data._data),
        lambda: (inner._env.physics.model.ptr, inner._env.physics.data.ptr),
    ]
    for getter in getters:
        try:
            model, data = getter()
        except AttributeError:
            continue
        if type(model).__name__ == "MjModel":
            return model, data
    raise Unusable(
        f"`{spec}` has no MuJoCo model that is known here: name its cameras by `render` or by a "
        "key of the observation, with --camera"
    )


def _attribute(env: Any, names: tuple[str, ...]) -> Any:
    """Returns the first of these attributes that the environment or a wrapper has."""
    while env is not None:
        for name in names:
            if vars(env).get(name) or (not hasattr(env, "env") and getattr(env, name, None)):
                return getattr(env, name)
        env = getattr(env, "env", None)
    return None


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """Yields the arrays of an observation with their keys, `pixels.top`."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _leaves(inner, f"{path}.{key}" if path else str(key))
    elif not isinstance(value, (str, tuple, list)):
        yield path or "observation", _array(value)


def _array(value: Any) -> np.ndarray:
    """Returns a NumPy array, without the batch dimension of pictures and of PyTorch tensors."""
    is_tensor = hasattr(value, "cpu")
    array = np.asarray(value.cpu() if is_tensor else value)
    is_batch = array.ndim == 4 or is_tensor and array.ndim > 1
    return array[0] if is_batch and len(array) == 1 else array


def _is_picture(value: np.ndarray) -> bool:
    return value.dtype == np.uint8 and value.ndim == 3 and value.shape[-1] == 3


def _leaf(key: str) -> str:
    return key.rpartition(".")[2]
