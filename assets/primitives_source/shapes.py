"""The shapes that the pack is made of: boxes, cylinders, capsules, and assemblies of them.

Lengths are metres, angles degrees, quaternions (w, x, y, z); z is up unless a shape has been
turned. A shape collides and has mass, or it is visible; most shapes are both. `mjcf.py` converts
shapes to MJCF."""

import math
from dataclasses import dataclass, replace

from colours import Colour

NO_ROTATION = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Shape:
    """One geom, with `kind` and `size` as in MuJoCo (half-lengths, radii)."""

    kind: str
    size: tuple
    pos: tuple
    quat: tuple = NO_ROTATION
    colour: Colour | None = None
    collides: bool = True

    @property
    def volume(self):
        if self.kind == "box":
            return 8 * math.prod(self.size)
        radius, half = self.size
        cylinder = 2 * math.pi * radius**2 * half
        return cylinder if self.kind == "cylinder" else cylinder + 4 / 3 * math.pi * radius**3


def box(low, high, colour=None):
    """The box between two opposite corners."""
    size = tuple((b - a) / 2 for a, b in zip(low, high))
    return Shape("box", size, tuple((a + b) / 2 for a, b in zip(low, high)), colour=colour)


def slab(half_x, half_y, bottom, top, colour=None):
    """A box centred on the z axis."""
    return box((-half_x, -half_y, bottom), (half_x, half_y, top), colour)


def cylinder(radius, bottom, top, colour=None):
    """An upright cylinder. MuJoCo gives a standing cylinder one contact point on a box: draw
    cylinders, but let things rest on `octagon`s and boxes."""
    return Shape("cylinder", (radius, (top - bottom) / 2), (0, 0, (bottom + top) / 2), colour=colour)


def capsule(start, end, radius, colour=None):
    """A rod with round ends whose axis runs from `start` to `end`."""
    along = [b - a for a, b in zip(start, end)]
    length = math.hypot(*along)
    x, y, z = (part / length for part in along)
    # The shortest rotation from the z axis to the rod's direction; for straight down, half a turn
    # about the x axis.
    quat = _unit((1 + z, -y, x, 0)) if z > -1 else (0.0, 1.0, 0.0, 0.0)
    middle = tuple((a + b) / 2 for a, b in zip(start, end))
    return Shape("capsule", (radius, length / 2), middle, quat, colour)


def visible(*shapes):
    """Copies of shapes that are drawn but do not collide."""
    return [replace(shape, collides=False) for shape in shapes]


def colliding(*shapes):
    """Copies of shapes that collide but are not drawn."""
    return [replace(shape, colour=None) for shape in shapes]


def turned(shapes, axis, degrees):
    """All shapes turned about a coordinate axis ("x", "y" or "z") through the origin."""
    half = math.radians(degrees) / 2
    turn = (math.cos(half), *(math.sin(half) * (name == axis) for name in "xyz"))
    return [
        replace(shape, pos=_rotate(turn, shape.pos), quat=_multiply(turn, shape.quat))
        for shape in shapes
    ]


def moved(shapes, by):
    return [replace(s, pos=tuple(a + b for a, b in zip(s.pos, by))) for s in shapes]


def standing_along_y(shapes):
    """Turns shapes from z up to y up: most groceries stand along their own y axis."""
    return turned(shapes, "x", -90)


def octagon(radius, bottom, top):
    """An invisible octagonal prism (`radius` to its corners) made of four intersecting boxes,
    because contacts between boxes are stable. Two of the boxes are half a millimetre shorter at
    each end, so that only the other two carry the weight: that halves the number of contacts, and
    objects stand as steadily."""
    long, short = radius * math.cos(math.pi / 8), radius * math.sin(math.pi / 8)
    bars = [slab(long, short, bottom + inset, top - inset) for inset in (0, 0.0005, 0, 0.0005)]
    return [piece for number, bar in enumerate(bars) for piece in turned([bar], "z", 45 * number)]


def wall(lower, upper, thickness, facets, colour):
    """A ring of flat facets between two (radius, height) pairs: the side of a bowl, mug or plate.

    The radii are measured to the middle of the wall's thickness."""
    (r0, z0), (r1, z1) = lower, upper
    run, rise = r1 - r0, z1 - z0
    half_width = max(r0, r1) * math.tan(math.pi / facets)
    upright = Shape("box", (thickness / 2, half_width, math.hypot(run, rise) / 2), (0, 0, 0), colour=colour)
    leaning = turned([upright], "y", math.degrees(math.atan2(run, rise)))
    facet = moved(leaning, ((r0 + r1) / 2, 0, (z0 + z1) / 2))
    return [piece for number in range(facets) for piece in turned(facet, "z", 360 * number / facets)]


def _unit(quat):
    norm = math.hypot(*quat)
    return tuple(part / norm for part in quat)


def _multiply(a, b):
    (aw, ax, ay, az), (bw, bx, by, bz) = a, b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def _rotate(quat, vector):
    w, x, y, z = quat
    _, *rotated = _multiply(_multiply(quat, (0, *vector)), (w, -x, -y, -z))
    return tuple(rotated)
