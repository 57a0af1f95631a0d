"""Names an environment, and what it does not say of itself."""

from __future__ import annotations

import argparse
import json
import re
from dataclasses import dataclass, field
from typing import Any

from .description import DIMENSIONS, Unusable

KINDS = ("gym", "lerobot", "vla-eval")


@dataclass(frozen=True)
class Settings:
    """A SPEC with its options; `arguments` has their meaning."""

    kind: str
    name: str
    keywords: dict[str, Any] = field(default_factory=dict)
    task_keyword: str = ""
    tasks: list[str] = field(default_factory=list)
    instructions: dict[str, str] = field(default_factory=dict)
    action: list[str] = field(default_factory=list)
    cameras: dict[str, str] = field(default_factory=dict)
    size: tuple[int, int] = (256, 256)
    state: dict[str, str] = field(default_factory=dict)
    control_hz: float = 0.0
    max_steps: int = 0
    success: str = ""
    reuse: bool = False

    @property
    def spec(self) -> str:
        """The SPEC as it was given."""
        return f"{self.kind}:{self.name}"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Adds SPEC and its options."""
    add = parser.add_argument
    add(
        "spec",
        metavar="SPEC",
        help="gym:[MODULE:]ID, a registered gymnasium environment; gym:MODULE:FUNCTION(), a "
        "function that returns one; lerobot:TYPE/TASK; or vla-eval:MODULE:CLASS",
    )
    add("--set", metavar="KEY=VALUE", action="append", default=[], help="keyword of construction")
    add(
        "--tasks",
        metavar="[KEY=]NAME,…",
        default="",
        help="tasks; with KEY, the keyword of construction that names the task. For vla-eval, some "
        "of its tasks [default: one task, or all of vla-eval]",
    )
    add(
        "--instruction",
        metavar="TASK=TEXT",
        action="append",
        default=[],
        help="a task's instruction [default: the environment's, else the words of its name]",
    )
    add(
        "--action",
        metavar="DIM,…",
        default="",
        help=f"meaning of each number of an action: {', '.join(DIMENSIONS)}, or `-` for another "
        "one; needed for the actuation axis",
    )
    add(
        "--camera",
        metavar="NAME=SOURCE",
        action="append",
        default=[],
        help="a camera: `mujoco.CAMERA` of the model, by name or index, `render`, or a key of the "
        "observation [default: the pictures in the observation, else `render`]",
    )
    add("--size", metavar="WxH", default="256x256", help="size of `mujoco` cameras' frames")
    add(
        "--state",
        metavar="NAME=KEY[A:B]",
        action="append",
        default=[],
        help="a reading: a key of the observation, `observation` if it has none, or a part of it "
        "[default: all readings of the observation]",
    )
    add("--control-hz", type=float, default=0.0, help="control steps per second")
    add("--max-steps", type=int, default=0, help="budget of a rollout, control steps")
    add(
        "--success",
        metavar="KEY",
        default="",
        help="key of `info` that reports success, or `terminated` [default: is_success, success]",
    )
    add(
        "--reuse",
        action="store_true",
        help="reuse an environment whose resets repeat [default: construct one for each rollout]",
    )


def settings(given: argparse.Namespace) -> Settings:
    """Reads the options; raises `Unusable`."""
    kind, _, name = given.spec.partition(":")
    if kind not in KINDS or not name:
        raise Unusable(
            f"SPEC is `{given.spec}`: write gym:ID, lerobot:TYPE/TASK or vla-eval:MODULE:CLASS"
        )
    keyword, equals, tasks = given.tasks.rpartition("=")
    action = [item.strip() for item in given.action.split(",") if item.strip()]
    for item in action:
        if item not in (*DIMENSIONS, "-") or item != "-" and action.count(item) > 1:
            raise Unusable(f"--action has `{item}`: write each of {', '.join(DIMENSIONS)} once")
    size = re.fullmatch(r"(\d+)x(\d+)", given.size)
    if size is None:
        raise Unusable(f"--size is `{given.size}`: write WIDTHxHEIGHT, for example 256x256")
    return Settings(
        kind=kind,
        name=name,
        keywords={key: _value(text) for key, text in _pairs("--set", given.set).items()},
        task_keyword=keyword if equals else "",
        tasks=[task for task in tasks.split(",") if task],
        instructions=_pairs("--instruction", given.instruction),
        action=["" if item == "-" else item for item in action],
        cameras=_pairs("--camera", given.camera),
        size=(int(size[1]), int(size[2])),
        state=_pairs("--state", given.state),
        control_hz=given.control_hz,
        max_steps=given.max_steps,
        success=given.success,
        reuse=given.reuse,
    )


def _pairs(option: str, given: list[str]) -> dict[str, str]:
    pairs = [text.partition("=") for text in given]
    for (key, equals, _), text in zip(pairs, given):
        if not key or not equals:
            raise Unusable(f"{option} is `{text}`: write NAME=VALUE")
    return {key: value for key, _, value in pairs}


def _value(text: str) -> Any:
    """JSON where it is JSON: numbers, true, lists; else the text itself."""
    try:
        return json.loads(text)
    except ValueError:
        return text
