"""Measures what a campaign costs: 200 nominal rollouts of two suites, three ways.

    python cost.py --bin FOLDER --output DIR [--sizes smolvla,pi05] [--arms rollout,…]

`rollout` is this project's coordinator, worker and gateway with the Python policy server;
`lerobot-async` is LeRobot's evaluation loop over asynchronous environments, and `openpi` is
openpi's example client (`loops.py`). All query a policy of random weights (`random_policy.py`), so
that rollouts last their whole budget. Rates are of a window after a warm-up, not of 200 whole
rollouts. DIR gets one JSON file for each arm and size, with every sample; an arm that has one is
not run again.

Hours of a whole campaign assume the given mean steps of successful rollouts and share of failures,
which last the whole budget. LeRobot's ten rollouts of a task last as long as the longest of them.
"""

import argparse
import atexit
import contextlib
import json
import os
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

from loops import SUITES
from random_policy import BATCHES, SIZES

HERE = Path(__file__).parent
TICKS = os.sysconf("SC_CLK_TCK")
ARMS = ("rollout", "lerobot-async", "openpi")
COLUMNS = ("arm", "policy", "executed", "rollouts/h", "control steps/s", "GPU busy", "in forward")
COLUMNS += ("cores", "host GiB", "GPU GiB", "whole campaign, h")
#: Actions that openpi's example executes of an answer.
REPLAN = 5


class Card:
    """The latest utilization and used memory of the GPU, from nvidia-smi."""

    def __init__(self) -> None:
        self.busy, self.mib = None, None
        if program := shutil.which("nvidia-smi"):
            query = "--query-gpu=utilization.gpu,memory.used"
            command = [program, query, "--format=csv,noheader,nounits", "-lms", "500", "-i", "0"]
            self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
            atexit.register(self.process.kill)
            threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        for line in self.process.stdout:
            self.busy, self.mib = (float(number) for number in line.split(","))


def processes() -> list[int]:
    """Returns all descendants of this process."""
    parents = {}
    for entry in os.listdir("/proc"):
        if entry.isdigit():
            with contextlib.suppress(OSError):
                stat = Path("/proc", entry, "stat").read_text()
                parents[int(entry)] = int(stat.rsplit(")", 1)[1].split()[1])
    found = [os.getpid()]
    for process in found:
        found += [child for child, parent in parents.items() if parent == process]
    return found[1:]


def sample(card: Card, meters: list[Path], with_memory: bool) -> dict:
    cpu_secs, host_mib = 0.0, 0.0
    for process in processes():
        # A process may have ended meanwhile. Its time is then in that of its parent.
        with contextlib.suppress(OSError):
            fields = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
            cpu_secs += sum(map(int, fields[11:15])) / TICKS
            if with_memory:
                fields = Path(f"/proc/{process}/smaps_rollup").read_text().split()
                host_mib += int(fields[fields.index("Pss:") + 1]) / 1024
    return {
        "at": time.time(),
        "cpu_secs": cpu_secs,
        "host_mib": host_mib,
        "busy": card.busy,
        "gpu_mib": card.mib,
        "meters": [json.loads(path.read_text()) for path in meters if path.exists()],
    }


@contextlib.contextmanager
def running(command: list[str]):
    """Runs a server whose first line is `listening on ADDRESS`; yields the address."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        line = process.stdout.readline().split()
        if line[:2] != ["listening", "on"]:
            raise SystemExit(f"error: {command[0]} printed {line} instead of its address")
        yield line[2]
    finally:
        process.terminate()
        process.wait(60)


@contextlib.contextmanager
def arm(name: str, size: str, arguments: argparse.Namespace, folder: Path):
    """Starts the processes of an arm. Yields the one whose end ends the arm, and the actions that
    are executed of an answer."""
    python = [sys.executable, "-W", "ignore"]
    loop = [*python, str(HERE / "loops.py")]
    loop_flags = ["--secs", str(arguments.secs), "--meter", str(folder / "loop.meter")]
    server_flags = ["--size", size, "--meter", str(folder / "server.meter")]
    execute = SIZES[size].execute
    with contextlib.ExitStack() as stack:
        if name == "openpi":
            server = stack.enter_context(running([*loop, "serve", *server_flags]))
            last = [*loop, "openpi", "--connect", server, "--execute", str(REPLAN), *loop_flags]
            execute = REPLAN
        elif name != "rollout":
            last = [*loop, "lerobot", "--size", size, *loop_flags]
            last += ["--envs", str(arguments.envs)]
        else:
            programs = ("coordinator", "policy-gateway", "worker")
            coordinator, gateway, worker = (str(arguments.bin / each) for each in programs)
            batches = ["--max-batch", str(arguments.max_batch)]
            server = [*python, str(HERE / "random_policy.py"), *server_flags, *batches]
            policy = f"random-{size}-size"
            route = f"{policy}=grpc://{stack.enter_context(running(server))}"
            listen = ["--listen", "127.0.0.1:0"]
            endpoint = stack.enter_context(running([gateway, *listen, "--route", route]))
            serving = [coordinator, "serve", *listen, "--data", str(folder / "data")]
            connect = ["--connect", f"http://{stack.enter_context(running(serving)).strip(',')}"]
            create = [coordinator, "campaign", "create", *connect, "--name", "cost"]
            create += ["--policy", policy, "--endpoint", f"http://{endpoint}", "--axes", "none"]
            create += ["--tasks", ",".join(SUITES), "--configs", "0-9", "--assets", "libero"]
            subprocess.run(create, check=True)
            last = [worker, *connect, "--slots", str(arguments.slots)]
        process = subprocess.Popen(last)
        try:
            yield process, execute
        finally:
            # A second signal gives unfinished rollouts back.
            for _ in range(2):
                process.terminate()
                time.sleep(0.5)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(10)
            process.kill()


def measure(name: str, size: str, arguments: argparse.Namespace, card: Card) -> dict:
    folder = arguments.output / f"{name}-{size}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    meters = [folder / "loop.meter", folder / "server.meter"]
    idle_mib, samples, windows, opens = card.mib or 0, [], {}, float("inf")
    ends = float("inf")
    with arm(name, size, arguments, folder) as (process, execute):
        while process.poll() is None and time.time() < ends:
            now = sample(card, meters, with_memory=len(samples) % 10 == 0)
            samples.append(now)
            found = now["meters"]
            suite = found[0].get("suite") if found else None
            if name == "rollout":
                # The server answered its own warm-up before.
                if ends == float("inf") and found[0] != samples[0]["meters"][0]:
                    opens = time.time() + arguments.warm_up
                    ends = opens + 2 * arguments.secs
                suite = "both" if now["at"] >= opens else None
            if suite:
                windows.setdefault(suite, []).append(now)
            time.sleep(0.5)
    if set(windows) != (set(SUITES) if name != "rollout" else {"both"}):
        code = process.returncode
        raise RuntimeError(f"{name} has windows {list(windows)} and ended with code {code}")
    inside = sum(windows.values(), [])
    return {
        "arm": name,
        "size": size,
        "execute": execute,
        "windows": {suite: rates(each[0], each[-1], execute) for suite, each in windows.items()},
        "busy": sum(each["busy"] or 0 for each in inside) / len(inside) / 100,
        "host_gib": max(each["host_mib"] for each in samples) / 1024,
        "gpu_gib": max((each["gpu_mib"] or 0) - idle_mib for each in samples) / 1024,
        "samples": samples,
    }


def rates(first: dict, last: dict, execute: int) -> dict:
    """Rates between two samples. The first meter is the loop's, if there is one, the last the
    server's."""
    pairs = [(first["meters"][which], last["meters"][which]) for which in (0, -1)]
    (start, end), (server_start, server_end) = pairs
    secs, server_secs = (after["at"] - before["at"] for before, after in pairs)
    answers = end["answers"] - start["answers"]
    steps = end["steps"] - start["steps"] if "steps" in end else execute * answers
    return {
        "secs": secs,
        "steps_per_sec": steps / secs,
        "forward": (server_end["forward_secs"] - server_start["forward_secs"]) / server_secs,
        "cores": (last["cpu_secs"] - first["cpu_secs"]) / (last["at"] - first["at"]),
        # The window of a campaign includes resets.
        "fixed_secs": end.get("fixed_secs", 0.0),
    }


def secs_per_rollout(result: dict, steps: dict[str, float]) -> float:
    """The mean over the suites, if their rollouts have so many control steps."""
    secs = 0.0
    for suite in SUITES:
        found = result["windows"].get(suite) or result["windows"]["both"]
        secs += found["fixed_secs"] + steps[suite] / found["steps_per_sec"]
    return secs / len(SUITES)


def summary(result: dict, arguments: argparse.Namespace) -> str:
    """Returns a line of the table."""
    # LeRobot's rollouts of a task end together.
    together = arguments.envs if result["arm"].startswith("lerobot") else 1
    failed = 1 - (1 - arguments.failures) ** together
    real = {
        suite: failed * budget + (1 - failed) * arguments.success_steps[suite]
        for suite, budget in SUITES.items()
    }
    windows = result["windows"].values()
    mean = {
        key: sum(each[key] for each in windows) / len(windows)
        for key in ("steps_per_sec", "forward", "cores")
    }
    cells = [
        result["arm"],
        f"random-{result['size']}-size",
        result["execute"],
        f"{3600 / secs_per_rollout(result, SUITES):.0f}",
        f"{mean['steps_per_sec']:.1f}",
        f"{100 * result['busy']:.0f} %",
        f"{100 * mean['forward']:.0f} %",
        f"{mean['cores']:.1f}",
        f"{result['host_gib']:.1f}",
        f"{result['gpu_gib']:.1f}",
        f"{arguments.rollouts * secs_per_rollout(result, real) / 3600:.1f}",
    ]
    return f"| {' | '.join(map(str, cells))} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bin", type=Path, help="folder of the programs; only prints without")
    parser.add_argument("--output", type=Path, required=True, help="folder of the results")
    parser.add_argument("--sizes", default="smolvla,pi05", help="sizes of the policy")
    parser.add_argument("--arms", default=",".join(ARMS))
    parser.add_argument("--secs", type=float, default=15, help="window of each suite")
    parser.add_argument("--warm-up", type=float, default=10, help="of the campaign")
    parser.add_argument("--slots", type=int, default=64)
    parser.add_argument("--max-batch", type=int, choices=BATCHES, default=16)
    parser.add_argument("--envs", type=int, default=10, help="environments of LeRobot")
    parser.add_argument("--rollouts", type=int, default=10_400, help="of a whole campaign")
    parser.add_argument("--failures", type=float, default=0.2, help="assumed share")
    parser.add_argument(
        "--success-steps",
        type=json.loads,
        # Mean lengths of LIBERO's demonstrations without idle steps.
        default='{"libero_object": 148, "libero_10": 268}',
        help="assumed mean control steps of a success, in JSON",
    )
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    card = Card()
    time.sleep(2)
    lines = []
    for size in arguments.sizes.split(","):
        for name in arguments.arms.split(","):
            path = arguments.output / f"{name}-{size}.json"
            if arguments.bin is None and not path.exists():
                continue
            began = time.monotonic()
            try:
                if not path.exists():
                    path.write_text(json.dumps(measure(name, size, arguments, card)))
            except (RuntimeError, SystemExit, subprocess.SubprocessError) as error:
                # The others still run; the same command repeats only this one.
                print(f"error: {error}", file=sys.stderr, flush=True)
                continue
            lines.append(summary(json.loads(path.read_text()), arguments))
            took = time.monotonic() - began
            print(f"{lines[-1]} took {took:.0f} s", file=sys.stderr, flush=True)
    print(f"| {' | '.join(COLUMNS)} |")
    print("\n".join(["| --- " * len(COLUMNS) + "|", *lines]))


if __name__ == "__main__":
    main()
