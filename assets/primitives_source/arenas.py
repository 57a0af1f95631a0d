"""The rooms: floor, walls, table, lights and cameras of each LIBERO arena, and their textures.

LIBERO's arena code picks a floor and a wall texture by file name, so those files must exist: in
this pack they are a few plain pixels each. Positions of walls, lights and cameras are LIBERO's,
because light and view are part of what the benchmark perturbs."""

import struct
import xml.etree.ElementTree as ET
import zlib

from colours import *
from mjcf import FIRM, numbers, to_bytes, write_classes, write_colours, write_shapes
from shapes import box, capsule, cylinder, moved, visible

# Textures by file name: colour of the tile, and of the joint between tiles along two of its edges,
# red green blue from 0 to 255.
TEXTURES = {
    "light-gray-floor-tile.png": ((168, 164, 160), (142, 138, 134)),
    "gray_ceramic_tile.png": ((150, 154, 158), (118, 122, 126)),
    "seamless_wood_planks_floor.png": ((158, 122, 88), (126, 94, 64)),
    "light-gray-plaster.png": ((206, 206, 202), (206, 206, 202)),
    "yellow_linen_wall_texture.png": ((222, 208, 166), (222, 208, 166)),
}

# Name, centre, half-sizes and orientation of the walls, which are visible but do not collide.
CORNERED_WALLS = [
    ("wall_leftcorner_visual", (-1.25, 2.25, 1.5), (1.06, 1.5, 0.01), (0.6532815, 0.6532815, 0.2705981, 0.2705981)),
    ("wall_rightcorner_visual", (-1.25, -2.25, 1.5), (1.06, 1.5, 0.01), (0.6532815, 0.6532815, -0.2705981, -0.2705981)),
    ("wall_left_visual", (1.25, 3, 1.5), (1.75, 1.5, 0.01), (0.7071, 0.7071, 0, 0)),
    ("wall_right_visual", (1.25, -3, 1.5), (1.75, 1.5, 0.01), (0.7071, -0.7071, 0, 0)),
    ("wall_rear_visual", (-2, 0, 1.5), (1.5, 1.5, 0.01), (0.5, 0.5, 0.5, 0.5)),
    ("wall_front_visual", (3, 0, 1.5), (3, 1.5, 0.01), (0.5, 0.5, -0.5, -0.5)),
]
SQUARE_WALLS = [
    ("wall_left_visual", (0.5, 3, 1.5), (2.5, 1.5, 0.01), (0.7071, 0.7071, 0, 0)),
    ("wall_right_visual", (0.5, -3, 1.5), (2.5, 1.5, 0.01), (0.7071, -0.7071, 0, 0)),
    ("wall_rear_visual", (-2, 0, 1.5), (3, 1.5, 0.01), (0.5, 0.5, 0.5, 0.5)),
    ("wall_front_visual", (3, 0, 1.5), (3, 1.5, 0.01), (0.5, 0.5, -0.5, -0.5)),
]

# Colours of tables and scenery. Every room declares all of them.
ROOM_COLOURS = [BLACK, BLUE, BROWN, DARK_RED, DARK_WOOD, GREEN, LIGHT_WOOD, OAK, PORCELAIN, SOOT, STEEL, WALNUT]

LIGHTS = [("light1", (1, 1, 4)), ("light2", (-3, -3, 4))]

# Name, position, orientation; the loader replaces some of these poses in each arena.
CAMERAS = [
    ("frontview", "1.0 0 1.45", "0.56 0.43 0.43 0.56"),
    ("birdview", "-0.2 0 3.0", "0.7071 0 0 0.7071"),
    ("agentview", "0.5 0 1.35", "0.653 0.271 0.271 0.653"),
    (
        "sideview",
        "-0.05651774593317116 1.2761224129427358 1.4879572214102434",
        "0.009905065491771751 0.006877963156909582 0.5912228352893879 0.806418094001364",
    ),
]


def arena(floor, wall, furnish, floor_in_body=False, walls=CORNERED_WALLS):
    """Returns one scene file. `furnish(worldbody)` adds the furniture; `floor_in_body` puts the
    floor into a body called `floor`, to which LIBERO attaches regions in some arenas."""
    mujoco = ET.Element("mujoco", model="arena")
    asset = ET.SubElement(mujoco, "asset")
    ET.SubElement(
        asset, "texture", type="skybox", builtin="gradient", rgb1="0.9 0.9 1", rgb2="0.2 0.3 0.4",
        width="256", height="256",
    )
    surfaces = (("texplane", "floorplane", floor, "0"), ("tex-wall", "walls_mat", wall, "0.5"))
    for texture, material, file, specular in surfaces:
        ET.SubElement(asset, "texture", name=texture, type="2d", file=f"../textures/{file}")
        ET.SubElement(
            asset, "material", name=material, texture=texture, texrepeat="3 3", texuniform="true",
            specular=specular, shininess="0.1",
        )
    write_colours(asset, ROOM_COLOURS)
    write_classes(mujoco, {
        "solid": {"group": "0", **FIRM},
        "drawn": {"group": "1", "contype": "0", "conaffinity": "0"},
    })
    world = ET.SubElement(mujoco, "worldbody")
    ground = ET.SubElement(world, "body", name="floor", pos="0 0 0") if floor_in_body else world
    ET.SubElement(
        ground, "geom", name="floor", type="plane", pos="0 0 0", size="3 3 0.125", condim="3", group="1",
        material="floorplane",
    )
    furnish(world)
    for name, pos, size, quat in walls:
        ET.SubElement(
            world, "geom", {"class": "drawn"}, name=name, type="box", pos=numbers(pos), size=numbers(size),
            quat=" ".join(map(str, quat)), material="walls_mat",
        )
    for name, pos in LIGHTS:
        ET.SubElement(
            world, "light", name=name, pos=numbers(pos), dir="0 -.15 -1", directional="false",
            castshadow="false", diffuse="0.8 0.8 0.8", specular="0.3 0.3 0.3",
        )
    for name, pos, quat in CAMERAS:
        ET.SubElement(world, "camera", name=name, mode="fixed", pos=pos, quat=quat)
    return to_bytes(mujoco)


def bare(world):
    """An empty room."""


def table(world):
    """A table whose size and height the loader sets, looking these geoms up by name."""
    body = ET.SubElement(world, "body", name="table", pos="0 0 0.4")
    top = {"type": "box", "pos": "0 0 0", "size": "0.4 0.4 0.4"}
    ET.SubElement(body, "geom", name="table_collision", group="0", friction="1 0.005 0.0001", **top)
    ET.SubElement(body, "geom", {"class": "drawn"}, name="table_visual", material=LIGHT_WOOD.name, **top)
    ET.SubElement(body, "site", name="table_top", pos="0 0 0.4", size="0.001", rgba="0 0 0 0")
    for leg in range(1, 5):
        ET.SubElement(
            body, "geom", {"class": "drawn"}, name=f"table_leg{leg}_visual", type="cylinder", pos="0 0 0",
            size="0.05 0.1", material=LIGHT_WOOD.name,
        )


def kitchen(world):
    """The table, and behind the robot a fridge and a worktop with a lamp above it."""
    write_shapes(world, visible(
        box((-1.95, -1.60, 0), (-1.40, 1.90, 0.86), PORCELAIN),
        box((-1.96, -1.62, 0.86), (-1.38, 1.92, 0.90), SOOT),
        box((-1.95, -2.80, 0), (-1.40, -1.70, 1.80), STEEL),
    ))
    ET.SubElement(
        world, "light", name="light_kitchen", pos="-1.75 0 1.6", dir="0 0 -1", directional="true",
        castshadow="false", diffuse="0.8 0.8 0.8", specular="0.8 0.8 0.8",
    )
    table(world)


def living_room(world):
    """A low table with cut corners on a broad foot. A single board carries all objects,
    because an object on the seam of two boards may be pushed along the table."""
    body = ET.SubElement(world, "body", name="living_room_table", pos="0 0 0")
    low, high = 0.4131, 0.4368
    write_shapes(ET.SubElement(body, "body", name="living_room_table_col"), [
        box((-0.8242, -0.6193, low), (0.3387, 0.7241, high), WALNUT),
        box((-0.6668, 0.7241, low), (0.1668, 0.9007, high), WALNUT),
        box((-0.6668, -0.8214, low), (0.1668, -0.6193, high), WALNUT),
        box((-0.6616, -0.1852, -0.0047), (0.1616, 0.6852, low), DARK_WOOD),
    ])


def study(world):
    """A desk, and behind the robot a bookcase, a plant and a picture."""
    body = ET.SubElement(world, "body", name="study_table", pos="0 0 0")
    write_shapes(body, [
        box((-0.6895, -1.3927, 0.8134), (0.6895, 1.3927, 0.8851), OAK),
        *(
            box((x, y, 0.0002), (x + 0.0400, y + 0.1006, 0.8134), DARK_WOOD)
            for x in (-0.5205, 0.4762) for y in (-0.7410, 0.6619)
        ),
    ])
    plant = [cylinder(0.13, 0, 0.28, PORCELAIN), cylinder(0.025, 0.28, 1.0, BROWN)] + [
        capsule((0, 0, height), (x, y, height + 0.25), 0.02, GREEN)
        for height, x, y in ((0.95, 0.2, 0.1), (0.9, -0.2, 0.1), (0.95, 0, -0.2), (0.85, 0.1, 0.22), (0.98, 0, 0.05))
    ]
    write_shapes(world, visible(
        *moved(plant, (-1.75, 0.5, 0)),
        *(box((-1.95, -1.60, z), (-1.60, -0.40, z + 0.03), STEEL) for z in (0.0, 0.44, 0.88, 1.32, 1.76)),
        *(box((-1.95, y, 0), (-1.60, y + 0.03, 1.79), SOOT) for y in (-1.63, -0.40)),
        *(box((-1.90, y, 0.91), (-1.70, y + 0.04, 1.16), colour) for y, colour in ((-0.50, BLACK), (-0.55, DARK_RED))),
        box((-1.98, 0.20, 1.15), (-1.96, 0.80, 1.60), BLUE),
    ))


def png(colour, joint):
    """Returns a picture of 64 × 64 pixels with a one-pixel joint along two edges, so that a
    repeated texture shows tiles. The picture has one bit per pixel and is stored uncompressed: the
    output of zlib differs between versions, and the pack must be the same everywhere."""
    rows = [b"\xff" * 8] + [b"\x80" + b"\0" * 7] * 63
    pixels = b"".join(b"\0" + row for row in rows)
    stored = b"\x78\x01\x01" + struct.pack("<HH", len(pixels), len(pixels) ^ 0xFFFF) + pixels
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", 64, 64, 1, 3, 0, 0, 0)),
        (b"PLTE", bytes(colour + joint)),
        (b"IDAT", stored + struct.pack(">I", zlib.adler32(pixels))),
        (b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )


def files():
    """Path inside the pack -> contents."""
    gray, plaster = "light-gray-floor-tile.png", "light-gray-plaster.png"
    out = {f"textures/{name}": png(*colours) for name, colours in TEXTURES.items()}
    out["scenes/libero_floor_base_style.xml"] = arena(gray, plaster, bare, floor_in_body=True)
    out["scenes/libero_tabletop_base_style.xml"] = arena(gray, plaster, table)
    out["scenes/libero_kitchen_tabletop_base_style.xml"] = arena(
        "gray_ceramic_tile.png", "yellow_linen_wall_texture.png", kitchen, walls=SQUARE_WALLS
    )
    out["scenes/libero_living_room_tabletop_base_style.xml"] = arena(
        "seamless_wood_planks_floor.png", plaster, living_room, floor_in_body=True
    )
    out["scenes/libero_study_base_style.xml"] = arena(gray, plaster, study)
    return out
