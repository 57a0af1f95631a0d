"""Looks of the pictures that the scripts in the folders beside this file record."""

import argparse
import pathlib
import re

#: As in the crate `libero-ctrl`, the default first.
LOOKS = ("mujoco-3.3.2", "mujoco-3.3.3")


def parse(parser: argparse.ArgumentParser) -> argparse.Namespace:
    """Adds a folder and `--look` to the arguments, parses them, makes MuJoCo draw in the look, and appends the look's
    name to the folder, which is created."""
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--look", choices=LOOKS, default=LOOKS[0])
    arguments = parser.parse_args()
    draw_as(arguments.look)
    arguments.folder = arguments.folder.resolve() / arguments.look
    arguments.folder.mkdir(parents=True, exist_ok=True)
    return arguments


def draw_as(look: str) -> None:
    """Makes MuJoCo 3.3.7 draw in a look. It decodes textures whose files declare sRGB, unless the MJCF names another
    colour space."""
    if look == "mujoco-3.3.3":
        return
    import mujoco

    load = mujoco.MjModel.from_xml_string

    def from_xml_string(xml, *arguments, **named):
        with_file = r"<texture (?=[^>]*\bfile=)"
        return load(re.sub(with_file, '<texture colorspace="linear" ', xml), *arguments, **named)

    mujoco.MjModel.from_xml_string = staticmethod(from_xml_string)
