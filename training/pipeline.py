"""Collects, trains, exports and evaluates a student, in calls that resume one another.

    python -m training.pipeline --data data --stage teach --minutes 9 --total-minutes 18
    python -m training.pipeline --data data --stage teach --minutes 9 --total-minutes 18
    python -m training.pipeline --data data --stage evaluate --minutes 4

``teach`` collects on the processor's cores while the GPU trains. In the first round the expert
drives, mostly disturbed. In each later round the student, with its newest weights, takes turns with
the expert, and tasks that the student failed before get more environments. Training draws on the
frames of all rounds; once its memory is full, new frames replace random ones. A call ends after
``--minutes``, and the same command resumes it; the learning rate decays over ``--total-minutes``,
the training time of all calls.

``evaluate`` exports the weights and measures the student on the benchmark's released initial
states, which no other stage uses.
"""

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

import torch

from training.collect import OUTCOMES, read_outcomes
from training.train import WEIGHTS

LEAVE_SECONDS = 12.0
"""Seconds before the end of a call at which collecting and training stop, to write files."""
MAX_ROUNDS = 40
"""Number of rounds from whose folders the trainer reads."""
THREADS = 16
"""Cores per collecting process. A machine with several times as many has several processes, since
the threads of one process contend for its interpreter lock (GIL)."""


def python(module: str, *arguments: object) -> list[str]:
    """Returns the command line of a module of this package."""
    return [sys.executable, "-u", "-m", f"training.{module}", *map(str, arguments)]


def rounds(data: Path) -> list[Path]:
    """Returns the folders of the rounds so far, in order: one for each collecting process."""
    return sorted(folder for folder in data.glob("round_*") if folder.is_dir())


def process_count(workers: int) -> int:
    """Returns the number of processes that collect a round."""
    return max(1, workers // THREADS)


def folders_to_train_on(data: Path, workers: int) -> list[Path]:
    """Returns the folders of all rounds so far, which may have had other numbers of processes, and
    of all possible further rounds."""
    processes = range(process_count(workers))
    possible = {
        data / f"round_{number:02}_{at}" for number in range(MAX_ROUNDS) for at in processes
    }
    return sorted(possible.union(rounds(data)))


def visible_gpus() -> list[str]:
    """Returns the names of the GPUs that this process may use, as in CUDA_VISIBLE_DEVICES."""
    chosen = os.environ.get("CUDA_VISIBLE_DEVICES")
    if chosen is not None:
        return [name.strip() for name in chosen.split(",") if name.strip()]
    return [str(at) for at in range(torch.cuda.device_count())]


def collectors(arguments: argparse.Namespace, seconds: float) -> list[subprocess.Popen[bytes]]:
    """Starts the processes that collect a round, on all cores."""
    number = len({folder.name.split("_")[1] for folder in rounds(arguments.data)})
    count = process_count(arguments.workers)
    processes = []
    for at in range(count):
        into = arguments.data / f"round_{number:02}_{at}"
        into.mkdir(parents=True)
        command = python(
            "collect", "--into", into, "--seconds", seconds, "--assets", arguments.assets,
            "--driver", "student" if number else "expert",
            "--weights", arguments.data / "run" / WEIGHTS,
            "--envs", arguments.envs // count, "--threads", max(1, arguments.workers // count),
            "--perturbed", arguments.perturbed, "--seed", 1000 * number + at,
            "--tasks", *arguments.tasks,
        )  # fmt: skip
        earlier = rounds(arguments.data)[:-1]
        if any((folder / OUTCOMES).exists() for folder in earlier):
            command += ["--failures", *map(str, earlier)]
        log = (arguments.data / f"{into.name}.log").open("wb")
        # The first GPU trains. Collecting processes are spread over the further GPUs, if there are
        # any, and otherwise use the first GPU too.
        further = visible_gpus()[1:]
        environment = (
            os.environ | {"CUDA_VISIBLE_DEVICES": further[at % len(further)]} if further else None
        )
        processes.append(
            subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, env=environment)
        )
    return processes


def teach(arguments: argparse.Namespace) -> None:
    """Collects and trains concurrently until this call's time is spent."""
    end = time.monotonic() + 60 * arguments.minutes - LEAVE_SECONDS
    arguments.data.mkdir(parents=True, exist_ok=True)
    folders = folders_to_train_on(arguments.data, arguments.workers)
    trainer = subprocess.Popen(
        python(
            "train", "--data", *folders, "--run", arguments.data / "run",
            "--seconds", 60 * arguments.total_minutes, "--watch", "--name", arguments.name,
            "--stop-after", end - time.monotonic(), "--batch", arguments.batch,
            "--processes", min(8, arguments.workers), "--wordings", arguments.wordings,
        )
    )  # fmt: skip
    running: list[subprocess.Popen[bytes]] = []
    try:
        while trainer.poll() is None and (remaining := end - time.monotonic()) > 20:
            first = not rounds(arguments.data)
            minutes = arguments.expert_minutes if first else arguments.round_minutes
            seconds = min(60 * minutes, remaining)
            running = collectors(arguments, seconds)
            while any(process.poll() is None for process in running) and trainer.poll() is None:
                time.sleep(1.0)
            if trainer.poll() is None:
                show_rounds(arguments.data)
        trainer.wait()
    finally:
        for process in [trainer, *running]:
            if process.poll() is None:
                process.terminate()
    show_rounds(arguments.data)
    if trainer.returncode:
        raise SystemExit(f"training ended with status {trainer.returncode}")


def show_rounds(data: Path) -> None:
    """Prints the last progress line of each collecting process, and the twelve tasks that the
    student, driving alone, failed most often in the newest two folders."""
    for folder in rounds(data):
        log = data / f"{folder.name}.log"
        lines = [line for line in log.read_text().splitlines() if " steps (" in line]
        print(f"{folder.name}: {lines[-1] if lines else log.read_text()[-500:]}", flush=True)
    alone = read_outcomes(rounds(data)[-2:])
    failing = sorted(alone.items(), key=lambda item: item[1][0] / item[1][1])[:12]
    counts = ", ".join(f"{name} {successes}/{total}" for name, (successes, total) in failing)
    print(f"tasks with most failures (successes/episodes): {counts}", flush=True)


def evaluate(arguments: argparse.Namespace) -> None:
    """Exports the weights and measures them."""
    weights = arguments.into / f"{arguments.name}.safetensors"
    subprocess.run(
        python("export", "--run", arguments.data / "run", "--name", arguments.name,
               "--into", weights, "--assets", arguments.assets,
               "--reference", arguments.into / "queries.safetensors"),
        check=True,
    )  # fmt: skip
    subprocess.run(
        python("evaluate", "--weights", weights, "--states", "released",
               "--episodes", arguments.episodes, "--threads", arguments.workers,
               "--envs", arguments.envs, "--assets", arguments.assets,
               "--tasks", *arguments.tasks,
               "--seconds", 60 * arguments.minutes, "--table", arguments.into / "released.json"),
        check=True,
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--stage", choices=["teach", "evaluate"], required=True)
    parser.add_argument("--data", type=Path, required=True, help="folder of all rounds and logs")
    parser.add_argument("--into", type=Path, default=Path("."), help="folder of exported files")
    parser.add_argument("--minutes", type=float, required=True, help="duration of this call")
    parser.add_argument("--total-minutes", type=float, default=18.0, help="training of all calls")
    parser.add_argument("--expert-minutes", type=float, default=3.0, help="length of first round")
    parser.add_argument("--round-minutes", type=float, default=5.0, help="length of later rounds")
    parser.add_argument(
        "--workers", type=int, default=len(os.sched_getaffinity(0)),
        help="number of cores to simulate on",
    )  # fmt: skip
    parser.add_argument("--envs", type=int, default=160, help="number of environments")
    parser.add_argument("--perturbed", type=float, default=0.0, help="share of perturbed episodes")
    parser.add_argument("--tasks", nargs="+", default=["libero"], help="prefixes of task names")
    parser.add_argument("--episodes", type=int, default=10, help="per task, in evaluate")
    parser.add_argument("--batch", type=int, default=1024, help="frames per training step")
    parser.add_argument("--wordings", type=int, default=4000, help="wordings per task")
    parser.add_argument("--assets", default="libero", help="asset pack or its folder")
    parser.add_argument("--name", default="student", help="name of the student and its file")
    arguments = parser.parse_args()
    {"teach": teach, "evaluate": evaluate}[arguments.stage](arguments)


if __name__ == "__main__":
    main()
