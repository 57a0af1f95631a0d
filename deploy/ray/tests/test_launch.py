"""The launcher on a Ray cluster of several nodes in this machine, with real programs."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

pytest.importorskip("ray", reason="Ray is not installed")
if "ROLLOUT_PROGRAMS" not in os.environ:
    pytest.skip("`cargo xtask test` names the programs", allow_module_level=True)

from ray.cluster_utils import Cluster

PROGRAMS = Path(os.environ["ROLLOUT_PROGRAMS"])
LAUNCH = Path(__file__).parents[1] / "launch.py"
PATIENCE = 240.0


class Lab:
    """A coordinator and a gateway, with the operator's commands."""

    def __init__(self, data: Path) -> None:
        self.processes: list[subprocess.Popen[str]] = []
        self.url = self.serve("coordinator", "serve", "--data", str(data))
        self.gateway = self.serve("policy-gateway", "--route", "expert=builtin:expert")

    def serve(self, program: str, *words: str) -> str:
        command = [str(PROGRAMS / program), *words, "--listen", "127.0.0.1:0"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self.processes.append(process)
        assert process.stdout is not None
        line = process.stdout.readline()
        return "http://" + line.removeprefix("listening on ").split()[0].strip(",")

    def coordinator(self, *words: str) -> str:
        command = [str(PROGRAMS / "coordinator"), *words, "--connect", self.url]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout

    def create(self, name: str) -> None:
        self.coordinator(
            *("campaign", "create", "--name", name, "--policy", "expert"),
            *("--endpoint", self.gateway, "--tasks", "libero_object/0-1", "--axes", "metric"),
            *("--levels", "L2", "--configs", "0-9", "--nominal", "eval"),
        )

    def rollouts(self, name: str) -> dict[str, int]:
        return json.loads(self.coordinator("campaign", "status", name, "--json"))["campaigns"][0][
            "rollouts"
        ]

    def workers(self) -> int:
        return len(json.loads(self.coordinator("workers", "--json"))["workers"])

    def stop(self) -> None:
        for process in self.processes:
            process.kill()
            process.wait()


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    lab = Lab(tmp_path)
    yield lab
    lab.stop()


@pytest.fixture
def cluster() -> Iterator[Cluster]:
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    yield cluster
    cluster.shutdown()


def until(event: str, condition: Callable[[], bool]) -> None:
    start = time.monotonic()
    while not condition():
        assert time.monotonic() - start < PATIENCE, f"{event}: not yet"
        time.sleep(0.25)


def launch(cluster: Cluster, lab: Lab, *words: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, str(LAUNCH), "--address", cluster.address, "--connect", lab.url]
    command += ["--assets", "primitives", "--programs", str(PROGRAMS), "--look-secs", "1"]
    return subprocess.Popen([*command, "--drain-secs", "0", "--idle-secs", "5", *words])


def test_a_lost_node_loses_no_rollout(cluster: Cluster, lab: Lab) -> None:
    nodes = [cluster.add_node(num_cpus=1, resources={"sim": 1}) for _ in range(2)]
    lab.create("ray")
    launcher = launch(cluster, lab, "--max-workers", "3", "--until-done")
    try:
        until("a worker on each node", lambda: lab.workers() == 2)
        until("some rollouts are committed", lambda: lab.rollouts("ray")["committed"] >= 4)
        cluster.remove_node(nodes[0])
        until("the lost node's worker is gone", lambda: lab.workers() == 1)
        cluster.add_node(num_cpus=1, resources={"sim": 1})
        until("a replacement runs", lambda: lab.workers() == 2)
        assert launcher.wait(timeout=PATIENCE) == 0
    finally:
        launcher.kill()
        launcher.wait()
    rollouts = lab.rollouts("ray")
    # 2 tasks × 10 configurations × 7 conditions: each of five axes, all five together, nominal.
    assert rollouts["committed"] == rollouts["total"] == 140
    jobs = json.loads(lab.coordinator("jobs", "ray", "--limit", "1000", "--json"))["jobs"]
    charged = {job["rollout_id"]: job["charged_attempts"] for job in jobs}
    assert not any(charged.values()), charged
    assert lab.workers() == 0


def test_workers_follow_the_queue_and_end_on_sigterm(cluster: Cluster, lab: Lab) -> None:
    cluster.add_node(num_cpus=2, resources={"sim": 2})
    launcher = launch(cluster, lab, "--max-workers", "2")
    try:
        time.sleep(5)
        assert lab.workers() == 0, "there is no work"
        lab.create("ray")
        until("two workers run", lambda: lab.workers() == 2)
        lab.coordinator("campaign", "pause", "ray")
        until("idle workers have ended", lambda: lab.workers() == 0)
        lab.coordinator("campaign", "resume", "ray")
        until("two workers run again", lambda: lab.workers() == 2)
        launcher.terminate()
        assert launcher.wait(timeout=60) == 0
    finally:
        launcher.kill()
        launcher.wait()
    assert lab.workers() == 0, "the workers signed off"
    assert lab.rollouts("ray")["leased"] == 0, "the workers gave back their rollouts"


def test_the_launcher_gives_up_after_repeated_failures(cluster: Cluster, lab: Lab) -> None:
    cluster.add_node(num_cpus=1, resources={"sim": 1})
    lab.create("ray")
    launcher = launch(cluster, lab, "--max-workers", "1", "--assets", "/nowhere")
    try:
        assert launcher.wait(timeout=120) == 1
    finally:
        launcher.kill()
        launcher.wait()
