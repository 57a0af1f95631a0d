#!/usr/bin/env python3
"""Draws the cases of `cases.json` with the original LIBERO: scenes whose changed lights cast shadows.

    record.py FOLDER [--look LOOK]

Writes a picture per case and camera into FOLDER/LOOK; the default look is mujoco-3.3.2. Needs the environment that
`cargo xtask bench compare` installs, or hf-libero 0.1.4, robosuite 1.4.0 and mujoco 3.3.7, with LIBERO's assets linked
as `libero/libero/assets`, and Mesa's llvmpipe (MUJOCO_GL=egl). As `shadows.rs` does, it writes a scene file per case,
sets the first initial state after a reset with seed 20260904, and draws without a step.
"""

import argparse
import io
import json
import os
import pathlib
import pickle
import re
import runpy
import sys
import tempfile
import zipfile

os.environ.setdefault("MUJOCO_GL", "egl")
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

import numpy as np
import original_look
from PIL import Image

HERE = pathlib.Path(__file__).resolve().parent
SEED = 20260904
SIDE = 128
CAMERAS = ("agentview", "robot0_eye_in_hand")
SCENES = {
    "tabletop": "libero_tabletop_base_style.xml",
    "floor": "libero_floor_base_style.xml",
    "kitchen": "libero_kitchen_tabletop_base_style.xml",
    "liv": "libero_living_room_tabletop_base_style.xml",
    "study": "libero_study_base_style.xml",
}


class States(pickle.Unpickler):
    """Unpickler of a file of initial states, whose array may come from an older NumPy."""

    def find_class(self, module, name):
        return super().find_class(module.replace("numpy.core", "numpy._core"), name)


def states(path) -> np.ndarray:
    with zipfile.ZipFile(path) as archive:
        (member,) = (name for name in archive.namelist() if name.endswith("/data.pkl"))
        return np.asarray(States(io.BytesIO(archive.read(member))).load())


def changed(text: str, lights: dict) -> str:
    """Returns a scene file with these attributes of lights and paths for a folder one level deeper."""
    text = text.replace('file="', 'file="../')
    for name, attributes in lights.items():
        (light,) = re.findall(rf'<light [^>]*name="{name}"[^>]*/>', text)
        replacement = light
        for attribute, value in attributes.items():
            replacement = re.sub(rf'(\b{attribute})="[^"]*"', rf'\1="{value}"', replacement)
        text = text.replace(light, replacement)
    return text


def main() -> None:
    from libero.libero import get_libero_path
    from libero.libero.envs import OffScreenRenderEnv

    output = original_look.parse(argparse.ArgumentParser()).folder
    assets = pathlib.Path(get_libero_path("assets")).resolve()
    # The package `benchmark` itself imports PyTorch.
    tasks = runpy.run_path(
        f"{get_libero_path('benchmark_root')}/benchmark/libero_suite_task_map.py"
    )["libero_task_map"]
    bddl, inits = (pathlib.Path(get_libero_path(name)) for name in ("bddl_files", "init_states"))
    folder = pathlib.Path(tempfile.mkdtemp())
    (folder / "scenes/lights").mkdir(parents=True)
    for file in assets.iterdir():
        if file.name != "scenes":
            (folder / file.name).symlink_to(file)
    for file in (assets / "scenes").iterdir():
        (folder / "scenes" / file.name).symlink_to(file)
    for case in json.loads((HERE / "cases.json").read_text()):
        base = (assets / "scenes" / SCENES[case["scene"]]).read_text()
        scene = folder / f"scenes/lights/{case['name']}.xml"
        scene.write_text(changed(base, case["lights"]))
        suite, number = case["task"].split("/")
        task = tasks[suite][int(number)]
        env = OffScreenRenderEnv(
            bddl_file_name=str(bddl / suite / f"{task}.bddl"),
            camera_heights=SIDE,
            camera_widths=SIDE,
            scene_xml=str(scene),
        )
        env.seed(SEED)
        env.reset()
        env.set_init_state(states(inits / suite / f"{task}.pruned_init")[0])
        for camera in CAMERAS:
            picture = env.sim.render(camera_name=camera, width=SIDE, height=SIDE)
            Image.fromarray(picture[::-1]).save(
                output / f"{case['name']}_{camera}.png", optimize=True
            )
        env.close()
        print(case["name"], flush=True)


if __name__ == "__main__":
    main()
