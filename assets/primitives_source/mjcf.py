"""Writes objects as MJCF in the structure that LIBERO's loader expects.

In this structure, an unnamed body holds the body `object` and three sites that tell the placement
sampler the object's extent. Geoms of group 0 collide and are hidden; geoms of group 1 are drawn.
Each geom has a default class, whose attributes the loader writes into the geom. The objects
themselves are defined in `fixtures.py`, `groceries.py` and `household.py`."""

import xml.etree.ElementTree as ET
from dataclasses import dataclass, field

# Contact constants of LIBERO's objects.
FIRM = {"friction": "0.95 0.3 0.1", "solref": "0.001 1", "solimp": "0.998 0.998 0.001"}


@dataclass(frozen=True)
class Site:
    """A MuJoCo site, by default an undrawn box against which goal predicates measure positions."""

    name: str
    pos: tuple
    size: tuple
    quat: tuple = (1, 0, 0, 0)
    kind: str = "box"
    rgba: tuple = (0.8, 0.8, 0.8, 0)


@dataclass(frozen=True)
class Joint:
    """A `slide` or `hinge` of a part: `limits` in metres or radians."""

    name: str
    kind: str
    axis: tuple
    limits: tuple
    damping: float


@dataclass
class Part:
    """A body: its sites, joint and shapes, and the parts attached to it."""

    name: str
    shapes: list = field(default_factory=list)
    sites: list = field(default_factory=list)
    joint: Joint | None = None
    parts: list = field(default_factory=list)
    pos: tuple = (0, 0, 0)
    quat: tuple = (1, 0, 0, 0)
    # Default class of the part's colliding shapes.
    collision_class: str = "solid"
    # (mass, moment of inertia about each axis); if None, computed from the shapes.
    inertia: tuple | None = None


@dataclass(frozen=True)
class Extent:
    """Extent of an object for the placement sampler: z of the bottom and top sites, xy of the
    radius site, and the size of the three sites, which are never drawn."""

    bottom: float
    top: float
    radius: float
    site_size: float = 0.005


def density_for(mass, shapes):
    """Returns the density in kg/m³ at which these shapes have this mass in kg. Like MuJoCo, the
    function counts overlapping volume twice."""
    return mass / sum(shape.volume for shape in shapes if shape.collides)


def document(model, root, extent, density, extra_classes=None):
    """Returns one object file. `root` becomes the body `object`; `extra_classes` are the default
    classes other than `solid` that parts name in `collision_class`."""
    mujoco = ET.Element("mujoco", model=model)
    ET.SubElement(mujoco, "compiler", angle="radian")
    write_colours(ET.SubElement(mujoco, "asset"), _colours_of(root))
    classes = {
        "solid": {"group": "0", "density": number(density), **FIRM},
        "drawn": {"group": "1", "contype": "0", "conaffinity": "0", "mass": "0"},
        **(extra_classes or {}),
    }
    write_classes(mujoco, classes)
    outer = ET.SubElement(ET.SubElement(mujoco, "worldbody"), "body")
    _write_part(outer, root, name="object")
    for name, pos in (
        ("bottom_site", (0, 0, extent.bottom)),
        ("top_site", (0, 0, extent.top)),
        ("horizontal_radius_site", (extent.radius, extent.radius, 0)),
    ):
        ET.SubElement(outer, "site", name=name, pos=numbers(pos), size=number(extent.site_size), rgba="0 0 0 0")
    return to_bytes(mujoco)


def write_colours(asset, colours):
    """Writes a material for each colour. A material has a one-coloured texture rather than `rgba`, because
    MuJoCo limits the light on a surface before it applies a texture, but after it applies `rgba`. A
    colour therefore looks the same in the brightest arena and under the lighting perturbation."""
    for name, rgb in sorted(set(colours)):
        ET.SubElement(asset, "texture", name=name, type="2d", builtin="flat", rgb1=numbers(rgb), width="2", height="2")
        ET.SubElement(asset, "material", name=name, texture=name, specular="0.3", shininess="0.3")


def write_classes(mujoco, classes):
    """Writes the default classes of a file. `classes` maps a class's name to the attributes of its
    geoms."""
    default = ET.SubElement(mujoco, "default")
    for name, attributes in classes.items():
        ET.SubElement(ET.SubElement(default, "default", {"class": name}), "geom", attributes)


def write_shapes(body, shapes, collision_class="solid"):
    """Writes colliding shapes as geoms of class `collision_class`, and visible shapes as geoms of class `drawn`."""
    for shape in shapes:
        place = {"type": shape.kind, "size": numbers(shape.size), "pos": numbers(shape.pos)}
        if number(shape.quat[0]) != "1":
            place["quat"] = numbers(shape.quat)
        if shape.collides:
            ET.SubElement(body, "geom", {"class": collision_class, **place})
        if shape.colour is not None:
            ET.SubElement(body, "geom", {"class": "drawn", **place, "material": shape.colour.name})


def number(value):
    """Formats a number with at most five decimals (10 µm), and never as -0."""
    return format(round(value, 5) + 0.0, "g")


def numbers(values):
    return " ".join(number(value) for value in values)


def to_bytes(mujoco):
    ET.indent(mujoco, "  ")
    return ET.tostring(mujoco, encoding="unicode").encode() + b"\n"


def _colours_of(part):
    colours = {shape.colour for shape in part.shapes if shape.colour is not None}
    return colours.union(*(_colours_of(child) for child in part.parts))


def _write_part(parent, part, name=None):
    body = ET.SubElement(parent, "body", name=name or part.name)
    if any(part.pos):
        body.set("pos", numbers(part.pos))
    if part.quat != (1, 0, 0, 0):
        body.set("quat", numbers(part.quat))
    if part.inertia is not None:
        mass, moment = part.inertia
        ET.SubElement(body, "inertial", pos="0 0 0", mass=number(mass), diaginertia=numbers((moment,) * 3))
    if part.joint is not None:
        joint = part.joint
        ET.SubElement(
            body, "joint", name=joint.name, type=joint.kind, axis=numbers(joint.axis), pos="0 0 0",
            limited="true", range=numbers(joint.limits), damping=number(joint.damping),
        )
    for site in part.sites:
        ET.SubElement(
            body, "site", name=site.name, type=site.kind, pos=numbers(site.pos), quat=numbers(site.quat),
            size=numbers(site.size), group="0", rgba=numbers(site.rgba),
        )
    write_shapes(body, part.shapes, collision_class=part.collision_class)
    for child in part.parts:
        _write_part(body, child)
