"""The groceries: cans, cartons, bottles and packets.

Every entry gives the object's extent for the placement sampler and its mass. These facts and the
overall dimensions are taken from LIBERO (the pack's README says how); the shapes are this pack's
own. Labels and stripes are drawn but do not collide."""

from colours import *
from mjcf import Extent, Part, density_for, document
from shapes import box, colliding, cylinder, moved, octagon, slab, standing_along_y, turned, visible

# Extent of most objects for the placement sampler.
COMMON_EXTENT = Extent(bottom=-0.06, top=0.04, radius=0.025)


def can(label, band):
    """A food can that stands along its y axis."""
    radius, bottom, top = 0.0325, -0.0386, 0.0405
    return standing_along_y(
        octagon(radius, bottom, top)
        + visible(
            cylinder(radius - 0.0005, bottom, top, STEEL),
            cylinder(radius, bottom + 0.006, top - 0.006, label),
            cylinder(radius + 0.0003, -0.014, 0.010, band),
        )
    )


def carton(side, stripe, roof):
    """A drink carton with a gabled roof that stands along its y axis; the ridge runs along x."""
    half, bottom, eaves, ridge = 0.0262, -0.0698, 0.0392, 0.0614
    slope = turned([box((-half, -0.0005, -0.0024), (half, 0.0275, 0), roof)], "x", -42)
    gable = moved(slope, (0, -0.0205, 0.0575))
    return standing_along_y(
        [slab(half, half, bottom, eaves, side), *gable, *turned(gable, "z", 180)]
        + [slab(half, 0.003, ridge - 0.006, ridge, side)]
        + visible(slab(half + 0.0004, half + 0.0004, -0.048, 0.002, stripe))
    )


def tapered_bottle(body, label, cap):
    """A flat squeeze bottle that stands along its y axis, broad along x."""
    return standing_along_y(
        [
            slab(0.0281, 0.0170, -0.0724, -0.0065, body),
            slab(0.0240, 0.0170, -0.0065, 0.0145, body),
            slab(0.0187, 0.0165, 0.0145, 0.0362, body),
        ]
        + octagon(0.0165, 0.0362, 0.0730)
        + visible(cylinder(0.0165, 0.0362, 0.0730, cap), slab(0.0286, 0.0174, -0.058, -0.016, label))
    )


def round_bottle(body, label, cap):
    """A bottle with a long neck and a broad cap that stands along its y axis."""
    return standing_along_y(
        colliding(
            slab(0.0175, 0.0173, -0.0727, -0.0625),
            slab(0.0235, 0.0173, -0.0625, 0.0010),
            slab(0.0264, 0.0173, -0.0524, -0.0104),
            slab(0.0130, 0.0148, 0.0010, 0.0356),
        )
        + octagon(0.0180, 0.0356, 0.0728)
        + visible(
            cylinder(0.0235, -0.0727, -0.0085, body),
            cylinder(0.0190, -0.0085, 0.0100, body),
            cylinder(0.0145, 0.0100, 0.0356, body),
            cylinder(0.0238, -0.0560, -0.0200, label),
            cylinder(0.0180, 0.0356, 0.0728, cap),
        )
    )


def flask(body, label, cap):
    """A small flat bottle, its length along z."""
    return [
        box((-0.0235, -0.0145, -0.0546), (0.0235, 0.0145, -0.0015), body),
        box((-0.0181, -0.0143, -0.0015), (0.0181, 0.0143, 0.0262), body),
        box((-0.0138, -0.0138, 0.0262), (0.0138, 0.0138, 0.0525), cap),
        *visible(slab(0.0239, 0.0149, -0.044, -0.012, label)),
    ]


def packet(half, middle, face, stripe):
    """A flat box of food lying down, with a stripe across the middle of its long side."""
    x, y, z = half
    along_x = x > y
    band = (x * 0.45, y, z) if along_x else (x, y * 0.45, z)
    low, high = (tuple(sign * (part + 0.0004) for part in band) for sign in (-1, 1))
    return moved([box(tuple(-part for part in half), half, face), *visible(box(low, high, stripe))], middle)


# Name: (extent, mass in kg, shapes).
GROCERIES = {
    "alphabet_soup": (Extent(-0.04, 0.04, 0.025), 0.02585, can(BLUE, YELLOW)),
    "bbq_sauce": (Extent(-0.06, 0.06, 0.015), 0.01218, flask(DARK_RED, ORANGE, RED)),
    "butter": (Extent(-0.02, 0.02, 0.02), 0.00525, packet((0.0381, 0.0198, 0.0087), (0, 0, 0), YELLOW, RED)),
    "chocolate_pudding": (
        COMMON_EXTENT, 0.01019, packet((0.0401, 0.0232, 0.0137), (-0.0005, 0, 0.0006), CHOCOLATE, CREAM),
    ),
    "cookies": (COMMON_EXTENT, 0.00964, packet((0.0310, 0.0413, 0.0094), (0, 0, 0), RED, YELLOW)),
    "cream_cheese": (
        Extent(-0.025, 0.025, 0.03), 0.00619, packet((0.0406, 0.0213, 0.0089), (0, 0, 0), BLUE, WHITE),
    ),
    "ketchup": (COMMON_EXTENT, 0.02322, tapered_bottle(RED, CREAM, WHITE)),
    "milk": (Extent(-0.06, 0.04, 0.03), 0.03167, carton(WHITE, BLUE, RED)),
    "orange_juice": (COMMON_EXTENT, 0.03167, carton(ORANGE, YELLOW, GREEN)),
    "salad_dressing": (COMMON_EXTENT, 0.02178, round_bottle(PALE_GREEN, DARK_GREEN, DARK_GREEN)),
    "tomato_sauce": (COMMON_EXTENT, 0.02663, can(RED, GREEN)),
}


def files():
    """Path inside the pack -> contents."""
    return {
        f"stable_hope_objects/{name}/{name}.xml": document(
            name, Part("object", shapes), extent, density_for(mass, shapes)
        )
        for name, (extent, mass, shapes) in GROCERIES.items()
    }
