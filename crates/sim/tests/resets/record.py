"""Records the placements and random draws of resets of the original LIBERO.

    python record.py recorded.json

Needs hf-libero 0.1.4, robosuite 1.4.0 and MuJoCo 3.3.7 with LIBERO's assets. No frame is rendered.
Every scenario seeds NumPy's global generator, constructs an environment and resets it several
times, with a few steps after each reset except in the crowded scene."""

import hashlib
import json
import pathlib
import sys

import numpy as np
from robosuite.utils.errors import RandomizationError

from libero.libero import get_libero_path
from libero.libero.envs.env_wrapper import ControlEnv

HERE = pathlib.Path(__file__).parent
ACTION = [0.2, -0.1, 0.15, 0.0, 0.1, 0.0, 1.0]
STEPS = 2
CROWDED = "crowded.bddl"
# File, seed, True for hard resets, number of resets.
SCENARIOS = [
    *(
        (f"libero_spatial/pick_up_the_black_bowl_{where}_and_place_it_on_the_plate.bddl", seed, hard, 3)
        for seed, (where, hard) in enumerate(
            [
                ("in_the_top_drawer_of_the_wooden_cabinet", True),
                ("in_the_top_drawer_of_the_wooden_cabinet", False),
                ("on_the_ramekin", True),
                ("on_the_cookie_box", False),
                ("on_the_stove", True),
                ("on_the_stove", False),
            ]
        )
    ),
    ("libero_object/pick_up_the_ketchup_and_place_it_in_the_basket.bddl", 10, True, 3),
    ("libero_object/pick_up_the_alphabet_soup_and_place_it_in_the_basket.bddl", 11, False, 3),
    ("libero_goal/put_the_wine_bottle_on_the_rack.bddl", 12, True, 3),
    ("libero_goal/turn_on_the_stove.bddl", 13, False, 3),
    ("libero_10/LIVING_ROOM_SCENE2_put_both_the_alphabet_soup_and_the_tomato_sauce_in_the_basket.bddl", 14, True, 2),
    ("libero_10/KITCHEN_SCENE4_put_the_black_bowl_in_the_bottom_drawer_of_the_cabinet_and_close_it.bddl", 15, True, 3),
    ("libero_10/STUDY_SCENE1_pick_up_the_book_and_place_it_in_the_back_compartment_of_the_caddy.bddl", 16, False, 2),
    ("libero_10/KITCHEN_SCENE8_put_both_moka_pots_on_the_stove.bddl", 17, True, 3),
    ("libero_10/KITCHEN_SCENE6_put_the_yellow_and_white_mug_in_the_microwave_and_close_it.bddl", 18, False, 3),
    ("libero_90/KITCHEN_SCENE10_close_the_top_drawer_of_the_cabinet.bddl", 21, True, 2),
    (CROWDED, 20260904, True, 5),
    (CROWDED, 5, False, 5),
]


def generator():
    """Returns the state of NumPy's global generator, with a digest in place of the words."""
    _, words, position, has_gauss, gauss = np.random.get_state(legacy=True)
    digest = hashlib.sha256(words.astype("<u4").tobytes()).hexdigest()
    return {"words_sha256": digest, "position": position, "has_gauss": has_gauss, "gauss": gauss}


def fixtures(env):
    model = env.sim.model
    return {
        fixture.root_body: [
            *model.body_pos[model.body_name2id(fixture.root_body)].tolist(),
            *model.body_quat[model.body_name2id(fixture.root_body)].tolist(),
        ]
        for fixture in env.env.fixtures
    }


def construct(file, seed, hard):
    """Returns the first seed, from `seed` up, that places all objects, and the environment."""
    while True:
        np.random.seed(seed)
        try:
            return seed, ControlEnv(
                bddl_file_name=str(file),
                hard_reset=hard,
                use_camera_obs=False,
                has_offscreen_renderer=False,
                has_renderer=False,
            )
        except RandomizationError:
            seed += 1


def record(name, seed, hard, resets):
    folder = HERE if name == CROWDED else pathlib.Path(get_libero_path("bddl_files"))
    seed, env = construct(folder / name, seed, hard)
    scenario = {"file": name, "seed": seed, "hard": hard, "constructed": generator(), "resets": []}
    original_reset, attempts = env.env.reset, [0]

    def count_and_reset():
        attempts[0] += 1
        return original_reset()

    env.env.reset = count_and_reset
    for _ in range(resets):
        attempts[0] = 0
        env.reset()
        state = env.get_sim_state()
        assert state[0] == 0.0 and not state[1 + env.sim.model.nq :].any()
        entry = {
            "attempts": attempts[0],
            "generator": generator(),
            "fixtures": fixtures(env),
            "qpos": state[1 : 1 + env.sim.model.nq].tolist(),
        }
        # In the crowded scene objects touch one another. Steps would depend on their meshes, and
        # the test also runs with the shapes of `primitives`.
        if name != CROWDED:
            for _ in range(STEPS):
                env.step(ACTION)
            entry["robot_qpos"] = env.sim.data.qpos[:9].tolist()
        scenario["resets"].append(entry)
    env.close()
    return scenario


if __name__ == "__main__":
    lines = [json.dumps(record(*scenario), separators=(",", ":")) for scenario in SCENARIOS]
    head = json.dumps({"action": ACTION, "steps": STEPS})
    # The records go to a file, because robosuite prints to standard output.
    pathlib.Path(sys.argv[1]).write_text(
        f'{head[:-1]}, "scenarios": [\n' + ",\n".join(lines) + "\n]}\n"
    )
