"""Collects camera frames with the actions that the scripted expert would take.

    python -m training.collect --into data/plain --seconds 300
    python -m training.collect --into data/driven --seconds 300 --driver student \\
        --weights runs/first/student.safetensors

LIBERO's samplers place the objects of every episode; the benchmark's released initial states are
never used. Earlier collections are kept: a further run adds shards, with other seeds.
"""

from __future__ import annotations

import argparse
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
from rollout_libero.scenes import scene_of_task
from training.drivers import ExpertDrives, InTurns, Orders
from training.network import PICTURE, STATE
from training.observations import RENDERED, frames, robot_state
from training.shards import Driver, Episode, Outcome, Writer, next_number
from training.student import Student
from training.wordings import TASK_NAMES, draw

STEPS_PER_FRAME = 4
"""Control steps between frames. It must divide the student's eight actions."""
SEVERAL = 2.0
"""Environments per task of libero_10, relative to other suites, because its episodes are longer
and their steps more diverse."""
FAILURES_WEIGHT = 3.0
"""Factor on the number of environments of a task that the student always fails."""
BUDGETS = 2
"""Default step limit of an episode, in multiples of the benchmark's: a learning student is slow."""
OUTCOMES = "outcomes.json"
"""File in the folder of shards: by task, the number of successes and of episodes in which the
student drove alone."""
REPORT_SECONDS = 10.0
WORDINGS = 200
"""Number of wordings of each task that the student may be given."""

SINGLE_AXES = ("camera", "lighting", "robot", "sensor", "actuation")
COMBINATION_SHARE = 0.5
"""Share of the perturbed episodes that are perturbed on all five axes."""
RADII = (0.5, 8.0)
"""Least and greatest radius; the benchmark's L3 is 8."""
CONFIGURATIONS = (10, 999)
"""First and last configuration; 0 to 9 are the benchmark's own directions."""


class Tally:
    """Counters for progress lines. Safe to use from several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._begun = time.monotonic()
        self.steps = 0
        self.frames = 0
        self._ended: list[tuple[int, Driver, bool]] = []

    def add_steps(self, steps: int, frames: int) -> None:
        """Adds steps and frames."""
        with self._lock:
            self.steps += steps
            self.frames += frames

    def add_episode(self, task: int, driver: Driver, success: bool) -> None:
        """Adds a finished episode."""
        with self._lock:
            self._ended.append((task, driver, success))

    def line(self) -> str:
        """Returns a progress line."""
        with self._lock:
            seconds = time.monotonic() - self._begun
            ended = list(self._ended)
        alone = [(_suite(task), success) for task, by, success in ended if by == Driver.STUDENT]
        guided = [(_suite(task), success) for task, by, success in ended if by != Driver.STUDENT]
        parts = [
            f"{seconds:4.0f} s",
            f"{self.steps:,} steps ({self.steps / seconds:,.0f}/s)",
            f"{self.frames:,} frames ({self.frames / seconds:,.0f}/s)",
            f"{len(ended):,} episodes",
            "success % " + _rates(guided),
        ]
        if alone:
            parts.append("student alone % " + _rates(alone))
        return "  ".join(parts)

    def alone(self) -> dict[str, list[int]]:
        """Returns by task the numbers of successes and of episodes in which the student drove
        alone."""
        found: dict[str, list[int]] = {}
        with self._lock:
            for task, driver, success in self._ended:
                if driver == Driver.STUDENT:
                    counts = found.setdefault(TASK_NAMES[task], [0, 0])
                    counts[0] += success
                    counts[1] += 1
        return found


def _suite(task: int) -> str:
    return TASK_NAMES[task].split("/")[0]


def _rates(ended: Sequence[tuple[str, bool]]) -> str:
    """Returns success rates in per cent by suite: ``spatial 99 object 100``."""
    parts = []
    for suite in dict.fromkeys(name.split("/")[0] for name in TASK_NAMES):
        successes = [success for name, success in ended if name == suite]
        if successes:
            percent = 100 * sum(successes) / len(successes)
            parts.append(f"{suite.removeprefix('libero_')} {percent:.0f}")
    return " ".join(parts) or "-"


class Pilot:
    """The student with the newest weights of a file, which may change or may not exist yet."""

    def __init__(self, file: Path | None, device: torch.device) -> None:
        self._file = file
        self._device = device
        self._stamp = 0
        self._student: Student | None = None
        self._lock = threading.Lock()

    def student(self) -> Student | None:
        """Returns the newest student, or None."""
        if self._file is None:
            return None
        with self._lock:
            stamp = self._file.stat().st_mtime_ns if self._file.exists() else 0
            if stamp != self._stamp:
                self._student, self._stamp = Student(self._file, self._device), stamp
                print(f"the student drives with {self._file}", flush=True)
            return self._student


class Group:
    """Environments that step together, and the episodes that run in them.

    Two groups alternate on the processor's cores: while one group's
    environments step, the other's frames are shrunk and stored.
    """

    def __init__(
        self,
        tasks: Sequence[int],
        writer: Writer,
        tally: Tally,
        pilot: Pilot,
        wordings: Sequence[Sequence[str]],
        *,
        steps_per_frame: int,
        budgets: int,
        solved_only: bool,
        perturbed: float,
        threads: int,
        seed: Sequence[int],
        assets: str,
        device: torch.device,
    ) -> None:
        n = len(tasks)
        names = [TASK_NAMES[task] for task in tasks]
        self._tasks = np.array(tasks)
        self._writer, self._tally, self._pilot = writer, tally, pilot
        self._wordings = wordings
        self._k = steps_per_frame
        self._solved_only = solved_only
        self._perturbed = perturbed
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
            max_steps=[budgets * rollout_libero.Task.of(name).max_steps for name in names],
            autoreset_mode=AutoresetMode.NEXT_STEP,
        )
        self._by_expert = ExpertDrives(n, self._rng)
        self._in_turns = InTurns(n, self._rng)
        # True for episodes that began after a student existed; the student takes turns in them.
        self._takes_part = np.zeros(n, bool)
        self._perturbations = [""] * n
        self._instructions = [""] * n

        most_steps = int(self._env.max_steps.max())
        most_frames = -(-most_steps // self._k)
        self._frame_count = np.zeros(n, np.int64)
        self._step_count = np.zeros(n, np.int64)
        # The system allocates pages of these arrays only when they are written.
        self._frames = np.empty((n, most_frames, 2, PICTURE, PICTURE, 3), np.uint8)
        self._state = np.empty((n, most_frames, STATE), np.float32)
        self._frame_step = np.empty((n, most_frames), np.int32)
        self._label = np.empty((n, most_steps, 7), np.float32)
        self._executed = np.empty((n, most_steps, 7), np.float32)
        self._source = np.empty((n, most_steps), np.uint8)

    def run(self, until: float) -> None:
        """Collects until this time of the monotonic clock."""
        try:
            while time.monotonic() < until:
                try:
                    self._run(until)
                except rollout_libero.SimulationError as error:
                    # Rare: the physics diverged after a push.
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
            acting = np.flatnonzero(~begins)
            self._store_frames(acting, pictures.cpu().numpy(), state)
            orders = self._orders(pictures, state)
            observation, _, terminated, truncated, info = self._env.step_chunk(
                orders.actions, "last", expert=orders.expert
            )
            self._store_steps(orders, info["taken"], info["expert_action"])
            self._tally.add_steps(int(info["taken"].sum()), len(acting))
            # Environments whose rollout had ended began the next one in this call.
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

    def _orders(self, pictures: torch.Tensor, state: NDArray[np.float32]) -> Orders:
        """Returns the environments' next actions from their drivers."""
        by_expert = self._by_expert.next(self._k)
        student = self._pilot.student()
        if student is None or not self._takes_part.any():
            return by_expert
        needs_student = self._in_turns.needs_answer() & self._takes_part
        if needs_student.any():
            indices = np.flatnonzero(needs_student)
            answers = student.act_on(
                pictures[torch.from_numpy(indices).to(self._device)],
                torch.from_numpy(state[indices]).to(self._device),
                [self._instructions[index] for index in indices],
            )
            self._in_turns.answer(needs_student, answers)
        in_turns = self._in_turns.next(self._k)
        part = self._takes_part[:, np.newaxis]
        return Orders(
            np.where(part[:, :, np.newaxis], in_turns.actions, by_expert.actions),
            np.where(part, in_turns.expert, by_expert.expert),
            np.where(part, in_turns.source, by_expert.source),
        )

    def _begin(self, indices: NDArray[np.int64]) -> None:
        """Begins episodes in some environments. Their first frames are stored next."""
        self._by_expert.begin(indices)
        self._in_turns.begin(indices)
        self._takes_part[indices] = self._pilot.student() is not None
        self._frame_count[indices] = self._step_count[indices] = 0
        for index in indices:
            wordings = self._wordings[self._tasks[index]]
            # Half of the episodes use the benchmark's own words.
            at = 0 if self._rng.random() < 0.5 else int(self._rng.integers(len(wordings)))
            self._instructions[index] = wordings[at]

    def _perturb(self, index: int) -> None:
        """Chooses the perturbation of the environment's next rollout."""
        chosen = ""
        if self._rng.random() < self._perturbed:
            chosen = perturbation(self._rng)
        if chosen or self._perturbations[index]:
            self._env.set_perturbation(index, chosen or None)
        self._perturbations[index] = chosen

    def _store_frames(
        self, indices: NDArray[np.int64], pictures: NDArray[np.uint8], state: NDArray[np.float32]
    ) -> None:
        at = self._frame_count[indices]
        self._frames[indices, at] = pictures[indices]
        self._state[indices, at] = state[indices]
        self._frame_step[indices, at] = self._step_count[indices]
        self._frame_count[indices] += 1

    def _store_steps(
        self, orders: Orders, taken: NDArray[np.int64], label: NDArray[np.float64]
    ) -> None:
        rows, steps = np.nonzero(np.arange(self._k) < taken[:, np.newaxis])
        at = self._step_count[rows] + steps
        labels, actions = label[rows, steps], orders.actions[rows, steps]
        if not np.isfinite(labels).all():
            bad = TASK_NAMES[self._tasks[rows[~np.isfinite(labels).all(axis=1)][0]]]
            raise RuntimeError(f"the expert has no action in {bad}: report it with the task's name")
        by_expert = orders.expert[rows, steps, np.newaxis]
        self._label[rows, at] = labels
        self._executed[rows, at] = np.where(
            by_expert, np.clip(labels + actions, -1.0, 1.0), actions
        )
        self._source[rows, at] = orders.source[rows, steps]
        self._step_count += taken

    def _end(self, index: int, outcome: Outcome) -> None:
        """Passes a finished episode to the writer."""
        count, steps = self._frame_count[index], self._step_count[index]
        self._frame_count[index] = 0
        drives = self._in_turns if self._takes_part[index] else self._by_expert
        driver = Driver(drives.driver[index])
        task = int(self._tasks[index])
        if outcome != Outcome.UNFINISHED:
            self._tally.add_episode(task, driver, outcome == Outcome.SUCCESS)
        if steps == 0 or (self._solved_only and outcome != Outcome.SUCCESS):
            return
        self._writer.add(
            Episode(
                task,
                outcome,
                driver,
                self._perturbations[index],
                self._frames[index, :count].copy(),
                self._state[index, :count].copy(),
                self._frame_step[index, :count].copy(),
                self._label[index, :steps].copy(),
                self._executed[index, :steps].copy(),
                self._source[index, :steps].copy(),
            )
        )


def perturbation(rng: np.random.Generator) -> str:
    """Returns a configuration on the benchmark's axes, in a direction that the benchmark lacks."""
    combined = rng.random() < COMBINATION_SHARE
    axis = "combination" if combined else SINGLE_AXES[rng.integers(len(SINGLE_AXES))]
    first, last = CONFIGURATIONS
    return f"{axis}/r{rng.uniform(*RADII):.3f}/c{rng.integers(first, last + 1):02}"


def read_outcomes(folders: Sequence[Path]) -> dict[str, list[int]]:
    """Returns by task the numbers of successes and of episodes in which the student drove alone,
    summed over these folders."""
    total: dict[str, list[int]] = {}
    for folder in folders:
        file = folder / OUTCOMES
        for name, counts in json.loads(file.read_text()).items() if file.exists() else ():
            earlier = total.setdefault(name, [0, 0])
            total[name] = [earlier[0] + counts[0], earlier[1] + counts[1]]
    return total


def tasks_of_environments(
    count: int, prefixes: Sequence[str], outcomes: Mapping[str, Sequence[int]]
) -> list[int]:
    """Returns the tasks of ``count`` environments, of those whose names begin with one of the
    prefixes. Tasks of libero_10 and tasks that the student
    fails get more environments; each task gets at least one, if there is room."""
    shares = np.zeros(len(TASK_NAMES))
    for number, name in enumerate(TASK_NAMES):
        solved, tried = outcomes.get(name, (0, 0))
        # Smoothing: two more tries are assumed, one of them successful.
        failing = 1 - (solved + 1) / (tried + 2) if outcomes else 0.0
        weight = 1 + (FAILURES_WEIGHT - 1) * failing
        long = name.startswith("libero_10/")
        shares[number] = name.startswith(tuple(prefixes)) * weight * (SEVERAL if long else 1.0)
    chosen = np.flatnonzero(shares)
    if not len(chosen):
        raise SystemExit(f"no task begins with {' or '.join(prefixes)}; an example is libero_10/9")
    if count < len(chosen):
        return [int(chosen[at * len(chosen) // count]) for at in range(count)]
    given = (shares > 0).astype(int)
    for _ in range(count - len(chosen)):
        # The next environment goes to the task furthest below its share.
        given[np.argmax(shares / np.maximum(given, 1))] += 1
    # Interleaved, so that each group gets a similar share of every task.
    turns = [np.flatnonzero(given > turn).tolist() for turn in range(int(given.max()))]
    return [task for turn in turns for task in turn]


def compile_scenes(tasks: Iterable[int], assets: str, threads: int) -> None:
    """Compiles the tasks' scenes concurrently and keeps them in ``SCENES``."""

    def compiled(task: int) -> Any:
        return scene_of_task(rollout_libero.Task.of(TASK_NAMES[task]), assets)

    with ThreadPoolExecutor(threads) as pool:
        SCENES.extend(pool.map(compiled, sorted(set(tasks))))


SCENES: list[Any] = []
"""Keeps compiled scenes alive, which would otherwise be freed with their last environment."""


def collect(arguments: argparse.Namespace) -> None:
    """Runs the groups until the time is spent."""
    until = time.monotonic() + arguments.seconds
    if arguments.driver == "student" and arguments.weights is None:
        raise SystemExit("collect with --driver student: name the student's file with --weights")
    device = torch.device(arguments.device)
    if device.type == "cpu":
        torch.set_num_threads(1)
    tally = Tally()
    pilot = Pilot(arguments.weights if arguments.driver == "student" else None, device)
    wordings = [draw(task, WORDINGS, arguments.seed) for task in TASK_NAMES]
    # A resumed run must not repeat the scenes of earlier runs.
    run = next_number(arguments.into)
    outcomes = read_outcomes(arguments.failures) if arguments.failures else {}
    groups_of = tasks_of_environments(arguments.envs, arguments.tasks, outcomes)
    compile_scenes(groups_of, arguments.assets, arguments.threads)
    count = min(arguments.groups, len(groups_of))
    writer = Writer(arguments.into)
    errors: list[BaseException] = []
    try:
        groups = [
            Group(
                groups_of[at::count],
                writer,
                tally,
                pilot,
                wordings,
                steps_per_frame=STEPS_PER_FRAME,
                budgets=arguments.budgets,
                solved_only=arguments.solved_only,
                perturbed=arguments.perturbed,
                threads=arguments.threads,
                seed=[arguments.seed, run, at],
                assets=arguments.assets,
                device=device,
            )
            for at in range(count)
        ]
        print(
            f"{len(groups_of)} environments in {count} groups on {arguments.threads} threads, into "
            f"{arguments.into} from shard {run} on",
            flush=True,
        )

        def work(group: Group) -> None:
            try:
                group.run(until)
            except BaseException as error:
                errors.append(error)

        workers = [threading.Thread(target=work, args=(group,)) for group in groups]
        for worker in workers:
            worker.start()
        for worker in workers:
            while worker.is_alive():
                worker.join(REPORT_SECONDS)
                print(tally.line(), flush=True)
    finally:
        writer.close()
        part = arguments.into / (OUTCOMES + ".part")
        part.write_text(json.dumps(tally.alone()))
        part.replace(arguments.into / OUTCOMES)
    if errors:
        raise errors[0]
    print(f"wrote shards {run} to {next_number(arguments.into) - 1}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--into", type=Path, required=True, help="folder of shards")
    parser.add_argument("--seconds", type=float, default=300.0, help="duration, start included")
    parser.add_argument("--driver", choices=["expert", "student"], default="expert")
    parser.add_argument(
        "--weights", type=Path,
        help="file of the student's weights, read again if it changes; the expert drives until it"
        " exists",
    )  # fmt: skip
    parser.add_argument(
        "--perturbed", type=float, default=0.0, metavar="SHARE", help="perturbed episodes, 0 to 1"
    )
    parser.add_argument("--envs", type=int, default=100, help="number of environments")
    parser.add_argument("--groups", type=int, default=2, help="alternating groups of environments")
    parser.add_argument("--threads", type=int, default=16, help="threads per group")
    parser.add_argument("--tasks", nargs="+", default=["libero"], help="prefixes of task names")
    parser.add_argument(
        "--budgets", type=int, default=BUDGETS,
        help="step limit of an episode, in multiples of the benchmark's",
    )  # fmt: skip
    parser.add_argument(
        "--solved-only", action="store_true", help="file only the episodes that end in success"
    )
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
