#!/usr/bin/env python3
"""Chooses what `record_chosen.py` records, by a rule that looks at names only.

    choice.py {plus,pro,para} ROOT

prints the cases. ROOT is the folder of the packages, as `record_chosen.py` says.

LIBERO-Plus: ten variants of each of the six dimensions that run with LIBERO's assets, including those that `record.py`
recorded earlier. The k-th new variant of a dimension has the k-th suite and difficulty, cyclically. If there is
no such variant, the suite is free (all floors are libero_object's), then the difficulty, too. Among the candidates, a
task that the dimension does not have yet comes first, then the lowest SHA-256 of `suite/variant`. Ten variants are held
out, which means that no code was changed after they were first compared: the last variant of each dimension, and the
last but one of the four dimensions with the most new variants. The repository keeps pictures of the first and the last
new variant of each dimension.

LIBERO-PRO: in a first round a task of each suite without an earlier recording by `record_pro.py`, in a second round
a further task of each suite with only one recording; the lowest SHA-256 of `suite/task` decides.

LIBERO-Para: for each of the ten tasks, the two sentences whose files' names have the lowest SHA-256. The repository
keeps pictures of the first sentence and the last.
"""

import ast
import hashlib
import pathlib
import re
import sys
from typing import NamedTuple

HERE = pathlib.Path(__file__).resolve().parent
BENCHMARK = HERE.parents[2] / "crates/benchmark"
SUITES = ("libero_spatial", "libero_object", "libero_goal", "libero_10")
SHORT = {"spatial": SUITES[0], "object": SUITES[1], "goal": SUITES[2], "long": SUITES[3]}
DIMENSIONS = ("camera", "robot", "language", "noise", "layout", "background")
PER_DIMENSION = 10
HELD_OUT = 10
#: Number of variants of the background whose floor and wall have textures of LIBERO.
FLOORS = 62
NOMINAL = "view_0_0_100_0_0"
SUFFIXES = {
    "camera": "view_{}_initstate_0",
    "robot": NOMINAL + "_initstate_{}",
    "noise": NOMINAL + "_initstate_0_noise_{}",
    "language": "language_{}_" + NOMINAL + "_initstate_0",
    "level": "level{}",
    "tb": "tb_{}",
    "table": "table_{}",
}
#: Number of LIBERO-PRO's tasks in the first round, and suites whose task of that round has pictures in the repository.
FIRST_ROUND = 7
PRO_PICTURES = ("libero_spatial_swap", "libero_object_task", "libero_10_lan", "libero_10_task")
#: Places of LIBERO-Para's sentences with pictures in the repository.
PARA_PICTURES = (0, 19)


class Variant(NamedTuple):
    dimension: str
    suite: str
    task: str
    name: str
    difficulty: str

    @property
    def path(self) -> str:
        return f"{self.suite}/{self.name}"


class Chosen(NamedTuple):
    variant: Variant
    is_held_out: bool
    #: True if the repository keeps its pictures.
    is_kept: bool


def digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def tasks() -> dict:
    """LIBERO's tasks by suite, in its order."""
    names = re.findall(r'^        "(\w+)",', (BENCHMARK / "src/suite.rs").read_text(), re.MULTILINE)
    return {suite: names[10 * index :][:10] for index, suite in enumerate(SUITES)}


def assigned(path: pathlib.Path, name: str):
    """The value that a module assigns to a name."""
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Assign) and node.targets[0].id == name:
            return ast.literal_eval(node.value)
    raise KeyError(name)


def variants(package: pathlib.Path) -> list:
    """The variants that run with LIBERO's assets; those with other lights or added objects need more."""
    style = package / "envs/arenas/style.py"
    files = {kind: assigned(style, f"{kind.upper()}_STYLE") for kind in ("floor", "wall")}
    spelled = lambda name: name.lower().replace("_", "-")
    files = {kind: {spelled(name): file for name, file in names.items()} for kind, names in files.items()}

    def has_textures(alias: str) -> bool:
        found = re.fullmatch(r"(?:Combined_)?Floor(?P<floor>.+?)(?:_Wall(?P<wall>.+))?", alias, re.IGNORECASE)
        if not found:
            return False
        styles = [(kind, spelled(name)) for kind, name in found.groupdict().items() if name]
        textures = [package / "assets/textures" / files[kind].get(name, "missing") for kind, name in styles]
        return all(texture.is_file() for texture in textures)

    known, found = tasks(), []
    for line in (BENCHMARK / "data/plus.txt").read_text().splitlines():
        short, index, kind, *items = line.split()
        if kind not in SUFFIXES:
            continue
        suite = SHORT[short]
        task = known[suite][int(index)]
        for item in items:
            number, difficulty, *alias = item.split(":")
            if kind in ("tb", "table") and not has_textures(alias[0]):
                continue
            number = number.replace("_", "_sample") if kind == "level" else number
            moved = "moved_" if (kind, suite) == ("level", "libero_goal") else ""
            dimension = {"level": "layout", "tb": "background", "table": "background"}.get(kind, kind)
            name = f"{task}_{moved}{SUFFIXES[kind].format(number)}"
            found.append(Variant(dimension, suite, task, name, difficulty))
    assert sum(variant.dimension == "background" for variant in found) == FLOORS
    return found


def recorded_first() -> set:
    return {line.split()[0] for line in (HERE / "states.txt").read_text().splitlines() if " reset " in line}


def plus(root: pathlib.Path) -> list:
    """The new variants: the first of each dimension, then the second, and so on."""
    known = variants(root / "liberoplus/liberoplus")
    first = recorded_first()
    rounds = []
    for dimension in DIMENSIONS:
        of_dimension = [variant for variant in known if variant.dimension == dimension]
        taken = [variant for variant in of_dimension if variant.path in first]
        new = []
        for turn in range(PER_DIMENSION - len(taken)):
            free = [variant for variant in of_dimension if variant not in taken + new]
            suite, difficulty = SUITES[turn % 4], str(turn % 5 + 1)
            candidates = [
                [one for one in free if (one.suite, one.difficulty) == (suite, difficulty)],
                [one for one in free if one.difficulty == difficulty],
                free,
            ]
            tasks_taken = [variant.task for variant in taken + new]
            best = next(filter(None, candidates))
            new.append(min(best, key=lambda one: (one.task in tasks_taken, digest(one.path))))
        rounds.append(new)
    most = sorted(rounds, key=len, reverse=True)[: HELD_OUT - len(DIMENSIONS)]
    held_out = [new[-1] for new in rounds] + [new[-2] for new in most]
    pictured = [new[place] for new in rounds for place in (0, -1)]
    ordered = [new[turn] for turn in range(PER_DIMENSION) for new in rounds if turn < len(new)]
    return [Chosen(one, one in held_out, one in pictured) for one in ordered]


def pro(root: pathlib.Path) -> list:
    """Pairs of suite and task: the first round, then the second."""
    lines = [line.split() for line in (HERE / "pro.txt").read_text().splitlines()]
    earlier = {(suite, task) for suite, task, *_ in lines}
    rounds: list = [[], []]
    for suite in (f"{suite}_{kind}" for suite in SUITES for kind in ("lan", "object", "swap", "task")):
        names = [file.stem for file in (root / "libero/libero/bddl_files" / suite).glob("*.bddl")]
        names.sort(key=lambda name: digest(f"{suite}/{name}"))
        names = [name for name in names if (suite, name) not in earlier]
        count = sum(suite == one for one, _ in earlier)
        for place, turn in enumerate(range(count, 2)):
            rounds[turn].append((suite, names[place]))
    assert len(rounds[0]) == FIRST_ROUND
    return rounds[0] + rounds[1]


def para(root: pathlib.Path) -> list:
    """Names of BDDL files."""
    files = [file.stem for file in (root / "libero/libero/bddl_files/libero_para").glob("*_eval*_ver*.bddl")]
    by_task = [[name for name in files if f"_eval{task}_" in name] for task in range(10)]
    return [name for names in by_task for name in sorted(names, key=digest)[:2]]


if __name__ == "__main__":
    for case in {"plus": plus, "pro": pro, "para": para}[sys.argv[1]](pathlib.Path(sys.argv[2])):
        print(case)
