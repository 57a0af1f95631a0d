#!/usr/bin/env python3
"""Draws the rollouts of `cases.json` with the original LIBERO: its scenes under presets of camera and lights.

    record.py REFERENCE FOLDER [--look LOOK]

Writes a picture per case and camera into FOLDER/LOOK; the default look is mujoco-3.3.2. REFERENCE is the folder
`perturb` of the reference data, whose poses and lights were computed from the written specification. Needs the same as
`../shadows/record.py`. Native collision detection is off. The pictures are those of the last of ten waits after the
rollout's initial state, upright. Presets of the camera do not change the wrist camera, so they have one picture.
"""

import argparse
import json
import os
import pathlib
import runpy
import sys

os.environ.setdefault("MUJOCO_GL", "egl")
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

import numpy as np
import original_look
from PIL import Image

HERE = pathlib.Path(__file__).resolve().parent
PRESETS = HERE.parents[2] / "crates/benchmark/data/presets.json"
SEED = 20260904
WAITS = 10
SIDE = 256
NO_OP = [0, 0, 0, 0, 0, 0, -1]
SUITES = {"long": "libero_10"}
CAMERAS = {"camera": ("agentview",), "lighting": ("agentview", "robot0_eye_in_hand")}


def perturb(model, axis: str, arrays, prefix: str, config: int) -> None:
    value = lambda name: arrays[f"{prefix}_{name}"][config]
    if axis == "camera":
        camera = model.camera("agentview")
        camera.pos[:], camera.quat[:] = value("cam_pos"), value("cam_quat")
        return
    for name in ("light_pos", "light_dir", "light_diffuse", "light_specular"):
        getattr(model, name)[:] = value(name)
    model.vis.headlight.ambient[:] = value("ambient")


def main() -> None:
    import mujoco

    from libero.libero import get_libero_path
    from libero.libero.envs import OffScreenRenderEnv

    parser = argparse.ArgumentParser()
    parser.add_argument("reference", type=pathlib.Path)
    arguments = original_look.parse(parser)
    states = runpy.run_path(str(HERE.parent / "shadows/record.py"))["states"]
    # The package `benchmark` itself imports PyTorch.
    tasks = runpy.run_path(
        f"{get_libero_path('benchmark_root')}/benchmark/libero_suite_task_map.py"
    )["libero_task_map"]
    bddl, inits = (pathlib.Path(get_libero_path(name)) for name in ("bddl_files", "init_states"))
    evaluated = json.loads(PRESETS.read_text())["eval_init_ids"]
    for case in json.loads((HERE / "cases.json").read_text()):
        short, number, axis, level, config = case.split("/")
        suite = SUITES.get(short, f"libero_{short}")
        index, config = int(number[1:]), int(config[1:])
        task = tasks[suite][index]
        env = OffScreenRenderEnv(
            bddl_file_name=str(bddl / suite / f"{task}.bddl"),
            camera_heights=SIDE,
            camera_widths=SIDE,
        )
        env.seed(SEED)
        env.reset()
        model = env.sim.model._model
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
        state = evaluated[suite][index][config]
        env.set_init_state(states(inits / suite / f"{task}.pruned_init")[state])
        perturb(model, axis, np.load(arguments.reference / f"model_{short}_{number}.npz"), level, config)
        for _ in range(WAITS):
            seen, *_ = env.step(NO_OP)
        for camera in CAMERAS[axis]:
            upright = seen[f"{camera}_image"][::-1]
            picture = f"{case.replace('/', '_')}_{camera}.png"
            Image.fromarray(upright).save(arguments.folder / picture, optimize=True)
        env.close()
        print(case, flush=True)


main()
