"""Collects camera frames with the actions that the scripted expert would take.

    python -m training.collect --into data/plain --seconds 300
    python -m training.collect --into data/driven --seconds 300 --driver student \\
        --weights runs/first/student.safetensors

LIBERO's samplers place the objects of every episode, except of those that begin in the states of
``--capsules``; only these have released initial states. Earlier shards are kept: a further run adds
shards with new seeds.
"""

import argparse
import contextlib
import json
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

import rollout_libero
from rollout_libero import Capsule
from rollout_libero.scenes import scene_of_task
from training.drivers import AlternatingDrivers, Commands, ExpertDriver
from training.network import ARM, CHUNK, PICTURE, STATE
from training.observations import RENDERED, frames, robot_state
from training.shards import Driver, Episode, Outcome, Writer, next_number
from training.student import Student
from training.wordings import TASK_NAMES, draw

STEPS_PER_FRAME = 4
"""Control steps between frames. It must divide each of ``drivers.HORIZONS``."""
LONG_TASK_WEIGHT = 2.0
"""Number of environments per task of libero_10, relative to a task of the other suites: episodes
of libero_10 are longer, and their steps more diverse."""
FAILURES_WEIGHT = 3.0
"""Factor on the number of environments of a task that the student always fails."""
BUDGETS = 2
"""Step limit of an episode, in multiples of the benchmark's limit. A learning student is slow."""
OUTCOMES = "outcomes.json"
"""File in the folder of shards. For each task, it counts the successes of the student driving
alone, and the episodes in which the student drove alone."""
REPORT_SECONDS = 10.0
GROUPS = 2
"""Groups of environments that take turns on the processor's cores."""
WORDINGS = 200
"""Number of wordings of each task from which the student's instructions are drawn."""

CAPSULE_SHARE = 0.5
"""Share of a task's episodes that begin in the states of its capsules, if it has any."""
SINGLE_AXES = ("camera", "lighting", "robot", "sensor", "actuation")
SIMULTANEOUS_SHARE = 0.5
"""Share of the perturbed episodes that are perturbed on all five axes."""
RADII = (0.5, 8.0)
"""Least and greatest radius of a perturbation; the benchmark's level L3 has radius 8."""
CONFIGURATIONS = (10, 999)
"""First and last configuration of perturbed episodes; 0 to 9 are the benchmark's own directions."""


class Tally:
    """Counts steps, frames and episodes for progress lines. Safe to use from several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._start = time.monotonic()
        self.steps = 0
        self.frames = 0
        self._results: list[tuple[int, Driver, bool]] = []

    def add_steps(self, steps: int, frames: int) -> None:
        with self._lock:
            self.steps += steps
            self.frames += frames

    def add_episode(self, task: int, driver: Driver, success: bool) -> None:
        with self._lock:
            self._results.append((task, driver, success))

    def line(self) -> str:
        """Returns a progress line. Its two success rates are of the episodes in which the expert
        drove, alone or in turns with the student, and of those in which the student drove alone."""
        with self._lock:
            seconds = time.monotonic() - self._start
            results = list(self._results)
        alone = [
            (_suite(task), success) for task, driver, success in results if driver == Driver.STUDENT
        ]
        guided = [
            (_suite(task), success) for task, driver, success in results if driver != Driver.STUDENT
        ]
        parts = [
            f"{seconds:4.0f} s",
            f"{self.steps:,} steps ({self.steps / seconds:,.0f}/s)",
            f"{self.frames:,} frames ({self.frames / seconds:,.0f}/s)",
            f"{len(results):,} episodes",
            "success in per cent: with the expert " + _rates(guided),
        ]
        if alone:
            parts.append("student alone " + _rates(alone))
        return "  ".join(parts)

    def student_outcomes(self) -> dict[str, list[int]]:
        """Counts for each task the successes of the student driving alone, and the episodes in
        which the student drove alone."""
        outcomes: dict[str, list[int]] = {}
        with self._lock:
            for task, driver, success in self._results:
                if driver == Driver.STUDENT:
                    counts = outcomes.setdefault(TASK_NAMES[task], [0, 0])
                    counts[0] += success
                    counts[1] += 1
        return outcomes


def _suite(task: int) -> str:
    return TASK_NAMES[task].split("/")[0]


def _rates(results: Sequence[tuple[str, bool]]) -> str:
    """Returns the success rate of each suite in per cent: ``spatial 99 object 100``."""
    parts = []
    for suite in dict.fromkeys(name.split("/")[0] for name in TASK_NAMES):
        successes = [success for name, success in results if name == suite]
        if successes:
            percent = 100 * sum(successes) / len(successes)
            parts.append(f"{suite.removeprefix('libero_')} {percent:.0f}")
    return " ".join(parts) or "-"


class NewestStudent:
    """The student with the newest weights of a file. The file may change, may not exist yet, and
    may be removed."""

    def __init__(self, file: Path | None, device: torch.device) -> None:
        self._file = file
        self._device = device
        self._stamp = 0
        self._student: Student | None = None
        self._lock = threading.Lock()

    def student(self) -> Student | None:
        """Returns the student with the file's newest weights, or None if there never was a file."""
        if self._file is None:
            return None
        with self._lock:
            with contextlib.suppress(FileNotFoundError):
                stamp = self._file.stat().st_mtime_ns
                if stamp != self._stamp:
                    self._student, self._stamp = Student(self._file, self._device), stamp
                    print(f"the student drives with {self._file}", flush=True)
            return self._student


class Group:
    """Environments that step together, and the episodes that run in them.

    The groups share the processor's cores: while one group's environments step,
    the frames of another are shrunk and stored."""

    def __init__(
        self,
        tasks: Sequence[int],
        writer: Writer,
        tally: Tally,
        newest_student: NewestStudent,
        wordings: Sequence[Sequence[str]],
        *,
        steps_per_frame: int,
        perturbed: float,
        capsules: Sequence[Capsule],
        threads: int,
        seed: Sequence[int],
        assets: str,
        device: torch.device,
    ) -> None:
        n = len(tasks)
        names = [TASK_NAMES[task] for task in tasks]
        self._tasks = np.array(tasks)
        self._writer, self._tally, self._newest_student = writer, tally, newest_student
        self._wordings = wordings
        self._steps_per_frame = steps_per_frame
        self._perturbed = perturbed
        self._capsules = [[one for one in capsules if one.task == name] for name in names]
        self._device = device
        self._rng = np.random.default_rng(seed)
        self._env = rollout_libero.VectorEnvironment(
            names,
            n,
            assets,
            threads=threads,
            height=RENDERED,
            width=RENDERED,
            orientation="upright",
            init_states="sampled",
            max_steps=[BUDGETS * rollout_libero.Task.of(name).max_steps for name in names],
            autoreset_mode=AutoresetMode.NEXT_STEP,
        )
        self._expert_driver = ExpertDriver(n, self._rng)
        self._alternating_drivers = AlternatingDrivers(n, self._rng)
        # True for environments whose episode began after a student existed: in these episodes
        # the student takes turns with the expert.
        self._student_takes_turns = np.zeros(n, bool)
        self._perturbations = [""] * n
        self._instructions = [""] * n

        most_steps = int(self._env.max_steps.max())
        most_frames = -(-most_steps // self._steps_per_frame)
        self._frame_count = np.zeros(n, np.int64)
        # The system allocates pages of these arrays only when they are written.
        self._frames = np.empty((n, most_frames, 2, PICTURE, PICTURE, 3), np.uint8)
        self._state = np.empty((n, most_frames, STATE), np.float32)
        self._target = np.empty((n, most_frames, CHUNK, ARM + 1), np.float32)

    def run(self, until: float) -> None:
        try:
            while time.monotonic() < until:
                try:
                    self._run(until)
                except rollout_libero.SimulationError as error:
                    # This is rare: the physics diverged after a push.
                    print(f"restarting {len(self._tasks)} episodes: {error}", flush=True)
        finally:
            self._env.close()

    def _run(self, until: float) -> None:
        n = len(self._tasks)
        for index in range(n):
            self._perturb(index)
        seeds = [int(seed) for seed in self._rng.integers(2**31, size=n)]
        observation, _ = self._env.reset(seed=seeds)
        self._begin(np.arange(n))
        begins = np.zeros(n, bool)
        pictures, state = self._network_inputs(observation)
        while time.monotonic() < until:
            target, progresses = self._env.foresee(CHUNK)
            stored = np.flatnonzero(~begins & progresses)
            self._store_frames(stored, pictures.cpu().numpy(), state, target)
            commands = self._next_commands(pictures, state)
            observation, _, terminated, truncated, info = self._env.step_chunk(
                commands.actions, "last", expert=commands.expert
            )
            self._tally.add_steps(int(info["taken"].sum()), len(stored))
            # `step_chunk` began the next rollout in environments whose rollout had ended before.
            if begins.any():
                self._begin(np.flatnonzero(begins))
            begins = terminated | truncated
            for index in np.flatnonzero(begins).tolist():
                self._end(index, Outcome.SUCCESS if terminated[index] else Outcome.FAILURE)
                self._perturb(index)
            pictures, state = self._network_inputs(observation)
        for index in np.flatnonzero(self._frame_count > 0).tolist():
            self._end(index, Outcome.UNFINISHED)

    def _network_inputs(
        self, observation: dict[str, NDArray[Any]]
    ) -> tuple[torch.Tensor, NDArray[np.float32]]:
        return frames(observation, self._device), robot_state(observation)

    def _next_commands(self, pictures: torch.Tensor, state: NDArray[np.float32]) -> Commands:
        """Returns the environments' next actions from their drivers."""
        by_expert = self._expert_driver.next(self._steps_per_frame)
        student = self._newest_student.student()
        if student is None or not self._student_takes_turns.any():
            return by_expert
        needs_student = self._alternating_drivers.needs_answer() & self._student_takes_turns
        if needs_student.any():
            indices = np.flatnonzero(needs_student)
            answers = student.act_on(
                pictures[torch.from_numpy(indices).to(self._device)],
                torch.from_numpy(state[indices]).to(self._device),
                [self._instructions[index] for index in indices],
            )
            self._alternating_drivers.answer(needs_student, answers)
        in_turns = self._alternating_drivers.next(self._steps_per_frame)
        takes_turns = self._student_takes_turns[:, np.newaxis]
        return Commands(
            np.where(takes_turns[:, :, np.newaxis], in_turns.actions, by_expert.actions),
            np.where(takes_turns, in_turns.expert, by_expert.expert),
        )

    def _begin(self, indices: NDArray[np.int64]) -> None:
        self._expert_driver.begin(indices)
        self._alternating_drivers.begin(indices)
        self._student_takes_turns[indices] = self._newest_student.student() is not None
        self._frame_count[indices] = 0
        for index in indices:
            wordings = self._wordings[self._tasks[index]]
            # Half of the episodes use the benchmark's own words.
            number = 0 if self._rng.random() < 0.5 else int(self._rng.integers(len(wordings)))
            self._instructions[index] = wordings[number]

    def _perturb(self, index: int) -> None:
        """Chooses the perturbation of the environment's next rollout, or the capsule in which it
        begins."""
        chosen = ""
        capsules = self._capsules[index]
        if self._rng.random() < self._perturbed:
            chosen = perturbation(self._rng)
        elif capsules and self._rng.random() < CAPSULE_SHARE:
            capsule = capsules[int(self._rng.integers(len(capsules)))]
            steps = int(self._rng.integers(capsule.steps + 1))
            self._env.set_perturbation(index, capsule.until(steps))
            self._perturbations[index] = capsule.row["rollout_id"]
            return
        if chosen or self._perturbations[index]:
            self._env.set_perturbation(index, chosen or None)
        self._perturbations[index] = chosen

    def _store_frames(
        self,
        indices: NDArray[np.int64],
        pictures: NDArray[np.uint8],
        state: NDArray[np.float32],
        target: NDArray[np.float64],
    ) -> None:
        frame = self._frame_count[indices]
        self._frames[indices, frame] = pictures[indices]
        self._state[indices, frame] = state[indices]
        self._target[indices, frame] = target[indices]
        self._frame_count[indices] += 1

    def _end(self, index: int, outcome: Outcome) -> None:
        count = self._frame_count[index]
        self._frame_count[index] = 0
        takes_turns = self._student_takes_turns[index]
        drivers = self._alternating_drivers if takes_turns else self._expert_driver
        driver = Driver(drivers.driver[index])
        task = int(self._tasks[index])
        if outcome != Outcome.UNFINISHED:
            self._tally.add_episode(task, driver, outcome == Outcome.SUCCESS)
        if not count:
            return
        self._writer.add(
            Episode(
                task,
                outcome,
                driver,
                self._perturbations[index],
                self._frames[index, :count].copy(),
                self._state[index, :count].copy(),
                self._target[index, :count].copy(),
            )
        )


def perturbation(rng: np.random.Generator) -> str:
    """Draws a configuration on the benchmark's axes, in a direction that the benchmark lacks."""
    combined = rng.random() < SIMULTANEOUS_SHARE
    axis = "simultaneous" if combined else SINGLE_AXES[rng.integers(len(SINGLE_AXES))]
    first, last = CONFIGURATIONS
    return f"{axis}/r{rng.uniform(*RADII):.3f}/c{rng.integers(first, last + 1):02}"


def read_outcomes(folders: Sequence[Path]) -> dict[str, list[int]]:
    """Returns the sums of the counts in the folders' files ``OUTCOMES``."""
    total: dict[str, list[int]] = {}
    for folder in folders:
        file = folder / OUTCOMES
        for name, counts in json.loads(file.read_text()).items() if file.exists() else ():
            earlier = total.setdefault(name, [0, 0])
            total[name] = [earlier[0] + counts[0], earlier[1] + counts[1]]
    return total


def add_outcomes(folder: Path, outcomes: Mapping[str, Sequence[int]]) -> None:
    """Adds counts to those of earlier runs in the folder's file ``OUTCOMES``."""
    total = read_outcomes([folder])
    for name, (successes, episodes) in outcomes.items():
        earlier = total.get(name, [0, 0])
        total[name] = [earlier[0] + successes, earlier[1] + episodes]
    part = folder / (OUTCOMES + ".part")
    part.write_text(json.dumps(total))
    part.replace(folder / OUTCOMES)


def tasks_of_environments(
    count: int, prefixes: Sequence[str], outcomes: Mapping[str, Sequence[int]]
) -> list[int]:
    """Returns the tasks of ``count`` environments, all with names that begin with one of the
    prefixes. Tasks of libero_10 and tasks that the student fails get more environments. Each task
    gets at least one environment, if there are enough."""
    shares = np.zeros(len(TASK_NAMES))
    for number, name in enumerate(TASK_NAMES):
        solved, tried = outcomes.get(name, (0, 0))
        # Smoothing: two more tries are assumed, one of them successful.
        failing = 1 - (solved + 1) / (tried + 2) if outcomes else 0.0
        weight = 1 + (FAILURES_WEIGHT - 1) * failing
        long = name.startswith("libero_10/")
        if long:
            weight *= LONG_TASK_WEIGHT
        shares[number] = name.startswith(tuple(prefixes)) * weight
    chosen = np.flatnonzero(shares)
    if not len(chosen):
        raise SystemExit(f"no task begins with {' or '.join(prefixes)}; an example is libero_10/9")
    if count < len(chosen):
        return [int(chosen[number * len(chosen) // count]) for number in range(count)]
    counts = (shares > 0).astype(int)
    for _ in range(count - len(chosen)):
        # The next environment goes to the task furthest below its share.
        counts[np.argmax(shares / np.maximum(counts, 1))] += 1
    # The tasks are interleaved, so that each group gets a similar share of every task.
    turns = [np.flatnonzero(counts > turn).tolist() for turn in range(int(counts.max()))]
    return [task for turn in turns for task in turn]


def compile_scenes(tasks: Iterable[int], assets: str, threads: int) -> None:
    """Compiles the tasks' scenes concurrently and keeps the scenes in ``SCENES``."""

    def compile_scene(task: int) -> Any:
        return scene_of_task(rollout_libero.Task.of(TASK_NAMES[task]), assets, None)

    with ThreadPoolExecutor(threads) as pool:
        SCENES.extend(pool.map(compile_scene, sorted(set(tasks))))


SCENES: list[Any] = []
"""Compiled scenes. The list keeps each scene from being freed with its last environment."""


def collect(arguments: argparse.Namespace) -> None:
    """Collects for ``--seconds`` seconds, start included."""
    until = time.monotonic() + arguments.seconds
    if arguments.driver == "student" and arguments.weights is None:
        raise SystemExit("--driver student needs weights: name the student's file with --weights")
    device = torch.device(arguments.device)
    if device.type == "cpu":
        torch.set_num_threads(1)
    tally = Tally()
    weights = arguments.weights if arguments.driver == "student" else None
    newest_student = NewestStudent(weights, device)
    wordings = [draw(task, WORDINGS, arguments.seed) for task in TASK_NAMES]
    # Part of the random seed, so that a resumed run does not repeat the placements of earlier runs.
    run = next_number(arguments.into)
    outcomes = read_outcomes(arguments.failures) if arguments.failures else {}
    tasks = tasks_of_environments(arguments.envs, arguments.tasks, outcomes)
    compile_scenes(tasks, arguments.assets, arguments.threads)
    count = min(GROUPS, len(tasks))
    writer = Writer(arguments.into)
    errors: list[BaseException] = []
    try:
        groups = [
            Group(
                tasks[number::count],
                writer,
                tally,
                newest_student,
                wordings,
                steps_per_frame=STEPS_PER_FRAME,
                perturbed=arguments.perturbed,
                capsules=Capsule.read(arguments.capsules) if arguments.capsules else [],
                threads=arguments.threads,
                seed=[arguments.seed, run, number],
                assets=arguments.assets,
                device=device,
            )
            for number in range(count)
        ]
        print(
            f"{len(tasks)} environments in {count} groups on {arguments.threads} threads, into "
            f"{arguments.into} from shard {run} on",
            flush=True,
        )

        def run_group(group: Group) -> None:
            try:
                group.run(until)
            except BaseException as error:
                errors.append(error)

        workers = [threading.Thread(target=run_group, args=(group,)) for group in groups]
        for worker in workers:
            worker.start()
        for worker in workers:
            while worker.is_alive():
                worker.join(REPORT_SECONDS)
                print(tally.line(), flush=True)
    finally:
        writer.close()
        add_outcomes(arguments.into, tally.student_outcomes())
    if errors:
        raise errors[0]
    print(f"wrote shards {run} to {next_number(arguments.into) - 1}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--into", type=Path, required=True, help="folder of shards")
    parser.add_argument("--seconds", type=float, default=300.0, help="duration, start included")
    parser.add_argument(
        "--driver", choices=["expert", "student"], default="expert",
        help="expert: the expert drives, in most episodes with noise and pushes added to its"
        " actions; student: student and expert take turns",
    )  # fmt: skip
    parser.add_argument(
        "--weights", type=Path,
        help="file of the student's weights, read again when it changes; until the file exists, the"
        " expert drives",
    )  # fmt: skip
    parser.add_argument(
        "--perturbed", type=float, default=0.0, metavar="SHARE",
        help="share of perturbed episodes, 0 to 1",
    )  # fmt: skip
    parser.add_argument(
        "--capsules", type=Path, metavar="FILE",
        help="rollouts that `coordinator jobs --capsule` wrote: half the episodes of their tasks"
        " begin at a random step of one, up to the last step that saves it",
    )  # fmt: skip
    parser.add_argument("--envs", type=int, default=100, help="number of environments")
    parser.add_argument("--threads", type=int, default=16, help="threads per group")
    parser.add_argument("--tasks", nargs="+", default=["libero"], help="prefixes of task names")
    parser.add_argument(
        "--failures", type=Path, nargs="+", metavar="FOLDER",
        help="folders of earlier shards: tasks that the student failed alone get more environments",
    )  # fmt: skip
    parser.add_argument("--assets", default="libero", help="asset pack or its folder")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    collect(parser.parse_args())


if __name__ == "__main__":
    main()
