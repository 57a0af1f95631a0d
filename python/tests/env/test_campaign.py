"""A campaign in another simulator, with the real programs: pairs, and faults that cost nothing."""

import contextlib
import json
import os
import pathlib
import re
import subprocess
import sys
import threading
import time

import pytest

pytest.importorskip("gymnasium")
pytest.importorskip("rollout_policies")

FOLDER = pathlib.Path(__file__).parent
SENSOR = {"noise_sigma": 0.1, "blur_sigma": 0, "jpeg_log2": 0, "motion_len": 0}
ACTUATION = {"gain_log2": 0, "bias_frac": 0.9, "misalign_deg": 0, "lag_tau": 0, "noise_frac": 0}
#: Longest wait for a campaign, s.
PATIENCE = 300
SEEDS = 2


class Program:
    """A running program with its output."""

    def __init__(self, *command, **variables):
        self.process = subprocess.Popen(
            list(map(str, command)),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env={**os.environ, **variables},
        )
        self.lines = []
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        for line in self.process.stdout:
            self.lines.append(line)

    @property
    def output(self):
        return "".join(self.lines)

    def wait_for(self, pattern):
        until = time.monotonic() + PATIENCE
        while not (found := re.search(pattern, self.output)):
            assert self.process.poll() is None and time.monotonic() < until, self.output
            time.sleep(0.1)
        return found

    def address(self):
        return self.wait_for(r"listening on (?:\w+://)?([\d.]+:\d+)")[1]

    def stop(self):
        self.process.terminate()
        self.process.wait(60)


def rows(*simulators):
    """Returns nominal, sensor, actuation and both of each simulator and seed, in the short form."""
    for simulator in simulators:
        for seed in range(SEEDS):
            row = {"simulator": simulator, "task": simulator.capitalize(), "seed": seed}
            yield row
            sensor, actuation = {"sensor": SENSOR}, {"actuation": ACTUATION}
            for perturb in (sensor, actuation, {**sensor, **actuation}):
                yield {**row, "axes": list(perturb), "radius": 4, "perturb": perturb}


@pytest.fixture(scope="module")
def system(programs, tmp_path_factory):
    """Starts all programs; returns the coordinator's commands, a campaign's run, and the worker."""
    data, markers = tmp_path_factory.mktemp("data"), tmp_path_factory.mktemp("markers")
    with contextlib.ExitStack() as stack:

        def start(*command, **variables):
            program = Program(*command, **variables)
            stack.callback(program.stop)
            return program

        serve = ("serve", "--listen", "127.0.0.1:0", "--data", data)
        coordinator = start(programs / "coordinator", *serve, "--progress-timeout-secs", 40)
        policy = start(sys.executable, FOLDER / "looking.py", "--listen", "127.0.0.1:0")
        route = f"looking=grpc://{policy.address()}"
        gateway = start(
            programs / "policy-gateway", "--listen", "127.0.0.1:0", "--route", route
        ).address()
        url = f"http://{coordinator.address()}"
        flags = ["--connect", url, "--assets", "primitives"]
        options = "--action x,y,gripper"
        for name in ("hold", "killed", "hanging", "reshaped", "unseeded"):
            spec = f"gym:holding:{name.capitalize()}()"
            flags += [
                "--simulator",
                f"{name}='{sys.executable}' -m rollout_env serve '{spec}' {options}",
            ]
        absent = f"'{sys.executable}' -m rollout_env serve gym:absent_package:Hold-v0"
        flags += ["--simulator", f"absent={absent}"]
        path = os.pathsep.join([str(FOLDER), *sys.path])
        worker = start(programs / "worker", *flags, PYTHONPATH=path, MARKERS=str(markers))

        def call(*arguments, given=None):
            command = [programs / "coordinator", *arguments, "--connect", url]
            done = subprocess.run(command, input=given, capture_output=True, text=True)
            assert done.returncode == 0, done.stderr
            return done.stdout

        def progress(name):
            (status,) = json.loads(call("campaign", "status", name, "--json"))["campaigns"]
            return status

        def run(name, simulators):
            lines = "".join(json.dumps(row) + "\n" for row in rows(*simulators))
            create = ("campaign", "create", "--name", name, "--rows", "-", "--policy", "looking")
            call(*create, "--endpoint", f"http://{gateway}", given=lines)
            until = time.monotonic() + PATIENCE
            while not (status := progress(name))["is_finished"]:
                assert time.monotonic() < until, (status, worker.output)
                time.sleep(0.5)
            results = call("export", name, "--format", "jsonl").splitlines()
            return {row["rollout_id"]: row for row in map(json.loads, results)}

        yield call, run, worker


def outcomes(results, task):
    conditions = ("nominal", "sensor", "actuation", "simultaneous")
    return [
        [
            row["success"]
            for row in results.values()
            if row["task_id"] == task and row["axis"] == axis
        ]
        for axis in conditions
    ]


def test_a_campaign_ends_with_paired_results(system):
    call, run, _ = system
    results = run("plain", ["hold"])
    assert outcomes(results, 0) == [[holds] * SEEDS for holds in (True, False, False, False)]
    assert results["sim/t0/nominal/i01"]["steps"] == 3
    assert results["sim/t0/sensor/r4/c01"]["steps"] == 6
    report = call("report", "plain", "--full")
    assert "hold/Hold" in report and "r4" in report and "L2" not in report, report
    assert "seed only" not in report, report
    shown = call("jobs", "plain", "sim/t0/sensor/r4/c01")
    assert re.search(r"prompt +hold still", shown), shown
    assert json.loads(call("report", "plain", "--json"))


def test_faults_are_named_and_cost_no_rollout(system):
    call, run, worker = system
    simulators = ("killed", "hanging", "reshaped", "unseeded")
    results = run("faults", simulators)
    assert len(results) == 4 * SEEDS * len(simulators)
    for task in range(len(simulators)):
        assert outcomes(results, task)[0] == [True] * SEEDS
    assert "quarantined        0" in call("campaign", "status", "faults")
    for text in (
        "`killed` did not answer step: its process was killed by SIGKILL",
        "`hanging` did not answer step within",
        "`reshaped` failed at step: reading `position` has the shape (3,), not (2,)",
    ):
        assert text in worker.output, worker.output
    report = call("report", "faults")
    assert "paired by seed only" in report and "unseeded/Unseeded" in report, report


def test_a_missing_package_is_named_and_its_rows_wait(system):
    call, _, worker = system
    worker.wait_for("simulator `absent` cannot be used: .*absent_package")
    (row, *_) = rows("absent")
    create = ("campaign", "create", "--name", "absent", "--rows", "-", "--policy", "looking")
    call(*create, "--endpoint", "http://127.0.0.1:1", "--no-probe", given=json.dumps(row))
    status = call("campaign", "status", "absent")
    assert "`--simulator absent=COMMAND`" in " ".join(status.split()), status
