"""The command line that `run` generates from a policy's constructor."""

import subprocess
import sys
import time
from pathlib import Path

import grpc
import numpy as np
import pytest
from conftest import Client, Plain, refusal, running

from rollout_policies import Description, Policy, run, start
from rollout_policies import command as command_module


class Flags(Plain):
    """Answers zeros.

    In 100 % of the cases."""

    def __init__(
        self,
        checkpoint: str,
        *,
        steps: int = 10,
        scale: float | None = None,
        fast: bool = True,
        quiet: bool = False,
        table: Path = Path("table"),
        noise=0.5,
        note: str | None = None,
        **others,
    ):
        self.given = (checkpoint, steps, scale, fast, quiet, table, noise, note)
        self.description = Description(name="flags", horizon=8)
        print("loading")

    def infer(self, observation):
        return np.zeros((8, 7))


@pytest.fixture
def run_command(monkeypatch):
    """Runs a command line. Returns the policy that would be served and its options."""

    def run_policy(policy_class, *arguments):
        served = []
        monkeypatch.setattr(
            command_module, "serve", lambda policy, **options: served.append((policy, options))
        )
        run(policy_class, arguments)
        [call] = served
        return call

    return run_policy


def test_parameters_become_flags_of_their_types(run_command):
    policy, options = run_command(Flags, "--checkpoint", "org/weights")
    assert policy.given == ("org/weights", 10, None, True, False, Path("table"), 0.5, None)
    assert policy.description.execute == 8
    assert options == {"listen": "127.0.0.1:0", "tls": None, "token_file": None, "insecure": False}
    policy, options = run_command(
        Flags,
        *("--checkpoint=w --steps 3 --scale 2 --no-fast --quiet --table /t --noise 1").split(),
        *("--note hm --execute 4 --listen localhost:0").split(),
    )
    assert policy.given == ("w", 3, 2.0, False, True, Path("/t"), 1.0, "hm")
    assert policy.description.execute == 4
    assert options["listen"] == "localhost:0"


def test_a_parameter_execute_of_the_policy_replaces_the_flag(run_command):
    class WithExecute(Flags):
        def __init__(self, execute: int = 2):
            self.description = Description(name="own", horizon=8, execute=execute)

    assert run_command(WithExecute)[0].description.execute == 2
    assert run_command(WithExecute, "--execute", "5")[0].description.execute == 5


def test_a_policy_without_a_constructor_has_the_servers_flags_only(run_command):
    class Plain(Policy):
        description = Description(name="plain", horizon=4)

        def reset(self, episode):
            pass

        infer = reset

    assert run_command(Plain, "--execute", "1")[0].description.execute == 1
    assert Plain.description.execute == 4


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], "--checkpoint"),
        (["--checkpoint", "w", "--steps", "many"], "--steps: invalid int value: 'many'"),
        (["--checkpoint", "w", "--execute", "9"], "--execute 9: policy 'flags': execute is 9"),
        (["--checkpoint", "w", "--listen", "0.0.0.0:0"], "other machines can reach that"),
        (["--checkpoint", "w", "--tls-cert", "c"], "give both"),
        (["--check", "w"], "--check"),
    ],
)
def test_a_wrong_command_line_is_refused_with_2(capsys, arguments, expected):
    with pytest.raises(SystemExit) as caught:
        run(Flags, arguments)
    assert caught.value.code == 2
    assert expected in capsys.readouterr().err


def test_access_errors_show_before_weights_are_loaded(capsys, tmp_path):
    listening = start(Flags("w"))
    try:
        for arguments, expected in (
            (["--token-file", str(tmp_path / "missing")], "missing: No such file"),
            (["--tls-cert", "c", "--tls-key", "k"], "certificate c and key k"),
            (["--listen", listening.address], listening.address),
            (["--listen", "localhost"], "'localhost' as an address.*HOST:PORT"),
        ):
            capsys.readouterr()
            with pytest.raises(SystemExit, match=expected):
                run(Flags, ["--checkpoint", "w", *arguments])
            assert "loading" not in capsys.readouterr().err
    finally:
        listening.stop(0)


def test_help_shows_the_docstring_and_fits_a_terminal(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit) as caught:
        run(Flags, ["--help"])
    assert caught.value.code == 0
    printed = capsys.readouterr().out
    for words in (
        "Answers zeros.\n\nIn 100 % of the cases.\n", "--steps INT", "default: 10",
        "--fast, --no-fast", "--checkpoint STR", "required", "--listen ADDR", "--token-file FILE",
        "--execute N",
    ):  # fmt: skip
        assert words in printed
    assert max(map(len, printed.splitlines())) <= 80


@pytest.mark.parametrize(
    ("constructor", "expected"),
    [
        (lambda self, sizes: None, None),
        (lambda self, sizes=(1, 2): None, r"parameter sizes=\(1, 2\) of Odd.*annotate"),
        (lambda self, listen="here": None, "has the name of a server flag.*rename"),
        (lambda self, help="me": None, "has the name of a server flag.*rename"),
        (lambda self, sizes, /: None, "parameter sizes of Odd"),
    ],
)
def test_a_parameter_that_cannot_be_a_flag_is_named(constructor, expected):
    odd = type("Odd", (Flags,), {"__init__": constructor})
    if expected is None:
        with pytest.raises(SystemExit):
            run(odd, ["--help"])
        return
    with pytest.raises(SystemExit, match=f"error: .*{expected}"):
        run(odd, ["--help"])


def test_run_refuses_an_instance():
    with pytest.raises(SystemExit, match="give it a subclass of rollout_policies.Policy"):
        run(Flags("w"), [])


async def infer_later(self, observation):
    return np.zeros(7)


@pytest.mark.parametrize(
    ("methods", "expected"),
    [
        ({}, "policy Own has no method 'infer': write `def infer(self, observation)`"),
        (
            {"infer": lambda self: None},
            "method 'infer' of policy Own takes (self), and the server calls infer(observation):"
            " write `def infer(self, observation)`",
        ),
        (
            {"infer": infer_later},
            "method 'infer' of policy Own is a coroutine, and the server calls plain functions:"
            " write `def infer(self, observation)`",
        ),
        (
            {"infer": lambda self, _: np.zeros(7), "end": None},
            "'end' of policy Own is not a method: write `def end(self, episode)`",
        ),
        (
            {"infer": lambda self, _: None},
            "policy Own cannot be served: its infer returned nothing; end it with `return actions`",
        ),
    ],
)
def test_the_error_for_an_unusable_class_has_the_line_to_write(methods, expected):
    attributes = {"description": Description("own"), "reset": lambda self, episode: None}
    with pytest.raises(SystemExit) as ended:
        run(type("Own", (Policy,), {**attributes, **methods}), [])
    assert str(ended.value).startswith("error: " + expected)


def test_resolved_settings_are_printed_before_the_address(tmp_path):
    script = tmp_path / "own.py"
    script.write_text(
        "from rollout_policies import *\n"
        "class Own(Policy):\n"
        "    def __init__(self, weights: str):\n"
        "        print('a model that prints while it loads')\n"
        "        self.description = Description('own', checkpoint=weights, settings={'a': 'b'})\n"
        "    def reset(self, episode): pass\n"
        "    def infer(self, observation): return [0.0] * 7\n"
        "run(Own)\n"
    )
    with open(tmp_path / "stderr", "w+") as errors:
        command = [sys.executable, str(script), "--weights", "org/w"]
        with running(*command, stderr=errors) as (_, address):
            errors.seek(0)
            lines = errors.read().splitlines()
            client = Client(address)
            assert client.describe().checkpoint == "org/w"
            client.channel.close()
    assert lines[:9] == [
        "a model that prints while it loads",
        "policy: own",
        "checkpoint: org/w",
        "cameras: none",
        "state: none",
        "horizon: 1",
        "execute: 1",
        "gripper: -1 open, 1 closed",
        "a: b",
    ]
    assert lines[9] == "warming up" and lines[10].startswith("warm after ")


def test_a_failing_warm_up_stops_the_server_before_it_listens(tmp_path, capfd):
    class Broken(Flags):
        def infer(self, observation):
            raise RuntimeError("no kernel image")

    with pytest.raises(RuntimeError, match="no kernel image"):
        run(Broken, ["--checkpoint", "w"])
    assert "listening" not in capfd.readouterr().out


def test_the_port_is_closed_during_the_warm_up(tmp_path):
    ready, go = tmp_path / "ready", tmp_path / "go"
    script = tmp_path / "own.py"
    script.write_text(
        "import pathlib, socket, sys, time\n"
        "from rollout_policies import *\n"
        "with socket.create_server(('127.0.0.1', 0)) as free:\n"
        "    port = free.getsockname()[1]\n"
        "class Own(Policy):\n"
        "    description = Description('own')\n"
        "    def warm_up(self):\n"
        f"        pathlib.Path({str(ready)!r}).write_text(str(port))\n"
        f"        while not pathlib.Path({str(go)!r}).exists(): time.sleep(0.01)\n"
        "    def reset(self, episode): pass\n"
        "    def infer(self, observation): return [0.0] * 7\n"
        "run(Own, ['--listen', f'127.0.0.1:{port}'])\n"
    )
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE) as process:
        while not (ready.exists() and ready.read_text()):
            assert process.poll() is None
            time.sleep(0.01)
        client = Client(f"127.0.0.1:{ready.read_text()}")
        code, _ = refusal(client.describe)
        assert code == grpc.StatusCode.UNAVAILABLE
        client.channel.close()
        go.touch()
        assert process.stdout.readline().startswith(b"listening on ")
        process.terminate()
