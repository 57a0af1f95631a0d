"""Keeps workers running on a Ray cluster, as many as a coordinator has work for.

    python launch.py --connect http://login1:7411 --max-workers 16

A worker is an actor that takes one `sim` resource, and a CPU for each of its slots. It
runs on nodes started with `ray start --resources '{"sim": N}'`, at most N per node. The
number of requested actors follows the coordinator's queue; Ray's autoscaler adds nodes for
actors that find no room. Workers without work for `--idle-secs` end by themselves. A lost
node takes its workers with it, and replacements are requested.
"""

from __future__ import annotations

import argparse
import json
import logging
import math
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from typing import Any

import ray
from ray.actor import ActorHandle
from ray.exceptions import RayActorError, RayTaskError

log = logging.getLogger("launch")

# Consecutive worker failures after which the launcher gives up: they probably have the same cause.
MAX_FAILURES_IN_A_ROW = 5
# Time that a worker needs to give back its unfinished rollouts, seconds.
GIVE_BACK_SECS = 15.0
# By default, Ray sends SIGKILL to the child processes of its actors, so a worker could not give its
# rollouts back.
KEEP_CHILDREN = {"RAY_kill_child_processes_on_worker_exit": "0"}
# Variables of the launcher that are passed to the workers; files that they name are on every node.
ENVIRONMENT = ("ROLLOUT_TOKEN_FILE", "ROLLOUT_CA", "ROLLOUT_SOURCES", "RUST_LOG")


@ray.remote
class SimWorker:
    """A worker process, for as long as the actor lives."""

    def __init__(self, command: list[str]) -> None:
        self.command = command
        self.process: subprocess.Popen[bytes] | None = None

    def node(self) -> str:
        """Returns the node's id. Ray answers once the actor has been placed."""
        return ray.get_runtime_context().get_node_id()

    def run(self) -> int:
        """Starts the worker, and returns its exit code when it ends."""
        # A lost node kills its actors and their process groups. The worker is outside these groups
        # and gets SIGTERM when its actor is gone, so it gives its rollouts back.
        guarded = ["setpriv", "--pdeathsig", "TERM", "--", *self.command]
        self.process = subprocess.Popen(guarded, start_new_session=True)
        return self.process.wait()

    def stop(self) -> None:
        """Asks the worker to end: it finishes its rollouts, or gives them back."""
        if self.process is not None and self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)


@dataclass
class RequestedActor:
    """A requested actor, with its placement and its worker's exit code."""

    actor: ActorHandle[Any]
    # Id of the actor's node; resolves when the actor has been placed.
    node: ray.ObjectRef[str]
    # Exit code of the actor's worker; resolves when the worker has ended.
    end: ray.ObjectRef[int]


class TooManyFailures(Exception):
    """Too many workers failed in a row."""


class Fleet:
    """The actors and their results."""

    def __init__(self, command: list[str], slots: int) -> None:
        self.command = command
        self.slots = slots
        self.actors: list[RequestedActor] = []
        self.failures = 0

    def collect_ended(self, wait: float) -> None:
        """Records workers that have ended, after waiting up to `wait` seconds for the first."""
        if not self.actors:
            time.sleep(wait)
            return
        ends = [requested.end for requested in self.actors]
        ended, _ = ray.wait(ends, num_returns=1, timeout=wait)
        ended += ray.wait(ends, num_returns=len(ends), timeout=0)[0]
        for requested in [actor for actor in self.actors if actor.end in ended]:
            self.actors.remove(requested)
            self._record_end(requested)

    def _record_end(self, requested: RequestedActor) -> None:
        try:
            code = ray.get(requested.end)
        except RayActorError as error:
            # The worker itself did not fail: a replacement is started.
            log.warning("a worker was lost with its node: %s", str(error).splitlines()[0])
            return
        except RayTaskError as error:
            code, ending = 1, f"could not be started: {error}"
        else:
            ending = f"ended with code {code}; its log is above"
        ray.kill(requested.actor)
        if code == 0:
            log.info("a worker ended")
            self.failures = 0
            return
        self.failures += 1
        log.error("a worker %s", ending)
        if self.failures >= MAX_FAILURES_IN_A_ROW:
            raise TooManyFailures(f"{self.failures} workers failed in a row")

    def scale_to(self, wanted: int) -> None:
        """Requests more workers, or cancels surplus ones that have not been placed yet."""
        while len(self.actors) < wanted:
            self.actors.append(self._start())
        unplaced = [actor for actor in self.actors if not ray.wait([actor.node], timeout=0)[0]]
        for surplus in unplaced[: max(0, len(self.actors) - wanted)]:
            ray.kill(surplus.actor)
            self.actors.remove(surplus)

    def _start(self) -> RequestedActor:
        environment = {name: os.environ[name] for name in ENVIRONMENT if name in os.environ}
        environment |= KEEP_CHILDREN
        actor = SimWorker.options(  # type: ignore[attr-defined]
            resources={"sim": 1},
            num_cpus=self.slots,
            max_concurrency=2,
            scheduling_strategy="SPREAD",
            runtime_env={"env_vars": environment},
        ).remote(self.command)
        return RequestedActor(actor, actor.node.remote(), actor.run.remote())

    def stop(self, patience: float) -> None:
        """Ends all workers; those that do not end in time are killed."""
        for requested in self.actors:
            requested.actor.stop.remote()
        if self.actors:
            ends = [requested.end for requested in self.actors]
            ray.wait(ends, num_returns=len(ends), timeout=patience)
        for requested in self.actors:
            ray.kill(requested.actor)
        self.actors.clear()


def queue_depth(coordinator: str, connect: str) -> int | None:
    """Returns the number of queued and leased rollouts of running campaigns; None on failure."""
    command = [coordinator, "campaign", "status", "--json", "--connect", connect]
    result = subprocess.run(command, capture_output=True, text=True)
    if result.returncode != 0:
        log.warning("the number of waiting rollouts is unknown: %s", result.stderr.strip())
        return None
    campaigns = json.loads(result.stdout)["campaigns"]
    running = [campaign["rollouts"] for campaign in campaigns if campaign["state"] == "running"]
    return sum(int(counts["queued"]) + int(counts["leased"]) for counts in running)


def arguments(words: list[str] | None = None) -> argparse.Namespace:
    """Parses the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    add = parser.add_argument
    add("--address", default="auto", help="the Ray cluster (default: the one of this machine)")
    add("--connect", required=True, help="URL of the coordinator, as the nodes reach it")
    add("--assets", default="libero", help="`libero`, `primitives`, or a folder on every node")
    add("--programs", default="", help="folder of the programs on every node (default: PATH)")
    add("--max-workers", type=int, required=True, help="largest number of workers at a time")
    add("--slots", type=int, default=1, help="slots of a worker, with one CPU each")
    add("--drain-secs", type=float, default=15, help="`--drain-secs` of each worker")
    add("--idle-secs", type=float, default=60, help="`--idle-secs` of each worker")
    add("--look-secs", type=float, default=5, help="seconds between polls of the queue")
    add("--until-done", action="store_true", help="end when no work and no worker is left")
    return parser.parse_args(words)


def run(options: argparse.Namespace) -> None:
    """Keeps workers running until a signal arrives or no work is left."""
    worker = os.path.join(options.programs, "worker")
    coordinator = os.path.join(options.programs, "coordinator")
    command = [worker, "--connect", options.connect, "--assets", options.assets]
    command += ["--slots", str(options.slots), "--drain-secs", str(options.drain_secs)]
    command += ["--idle-secs", str(options.idle_secs)]
    fleet = Fleet(command, options.slots)
    try:
        while True:
            work = queue_depth(coordinator, options.connect)
            if work is not None:
                wanted = min(options.max_workers, math.ceil(work / options.slots))
                if options.until_done and work == 0 and not fleet.actors:
                    return
                fleet.scale_to(wanted)
            fleet.collect_ended(options.look_secs)
    finally:
        fleet.stop(options.drain_secs + GIVE_BACK_SECS)


def main() -> int:
    """Runs the command line; returns 1 if too many workers failed in a row."""
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s")
    options = arguments()
    ray.init(address=options.address, log_to_driver=True)
    # SIGTERM is handled like Ctrl-C, so that the workers are stopped first. This call replaces the
    # handler that `ray.init` installs.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        run(options)
    except TooManyFailures as error:
        log.error("%s", error)
        return 1
    except KeyboardInterrupt:
        log.info("ended")
    return 0


if __name__ == "__main__":
    sys.exit(main())
