"""The household objects: dishes, mugs, pots, the bottle, the book, the basket.

Every entry gives the folder and the mass; the extent for the placement sampler is the same for all.
These facts and the overall dimensions are LIBERO's (the pack's README says how); the shapes are
this pack's own."""

from colours import *
from mjcf import Extent, Part, Site, density_for, document
from shapes import box, capsule, colliding, cylinder, moved, octagon, slab, turned, visible, wall

SCANNED, TURBOSQUID = "stable_scanned_objects", "turbosquid_objects"

# Extent of every household object for the placement sampler.
EXTENT = Extent(bottom=-0.06, top=0.04, radius=0.025)


def dish(base, profile, thickness, facets, colour, bottom_colour=None):
    """A round vessel: a square base that collides, a round bottom that is drawn, and a wall for
    each step of the profile.

    `base` is (radius, bottom, top); `profile` is a list of (radius, height). A `bottom_colour` other
    than `colour` makes the edge between bottom and wall visible from above in flat light."""
    radius, bottom, top = base
    inner = radius * 0.8
    steps = zip(profile, profile[1:])
    return (
        colliding(slab(inner, inner, bottom, top))
        + visible(cylinder(radius, bottom, top, bottom_colour or colour))
        + [piece for low, high in steps for piece in wall(low, high, thickness, facets, colour)]
    )


def handle(points, radius, colour):
    """Rods that join consecutive points."""
    return [capsule(start, end, radius, colour) for start, end in zip(points, points[1:])]


def porcelain_mug():
    body = dish((0.0290, 0.0024, 0.0120), [(0.0300, 0.0060), (0.0425, 0.0420), (0.0445, 0.1085)], 0.0046, 10, PORCELAIN)
    grip = [(-0.0320, 0, 0.0930), (-0.0590, 0, 0.0800), (-0.0590, 0, 0.0380), (-0.0270, 0, 0.0220)]
    return moved(body, (0.0125, -0.0010, 0)) + handle(grip, 0.0058, PORCELAIN)


def red_coffee_mug():
    body = dish((0.0300, 0.0002, 0.0060), [(0.0300, 0.0014), (0.0425, 0.1306)], 0.0060, 10, RED)
    grip = [(0.0150, 0, 0.0280), (0.0560, 0, 0.0740), (0.0550, 0, 0.1080), (0.0230, 0, 0.1110)]
    return moved(body, (-0.0157, -0.0006, 0)) + handle(grip, 0.0055, RED)


def white_yellow_mug():
    lower = dish((0.0270, 0.0002, 0.0052), [(0.0265, 0.0030), (0.0360, 0.0180), (0.0425, 0.0580)], 0.0070, 10, MUSTARD)
    upper = wall((0.0425, 0.0580), (0.0490, 0.1025), 0.0070, 10, WHITE)
    grip = [(0.0190, 0, 0.0260), (0.0630, 0, 0.0330), (0.0630, 0, 0.0790), (0.0260, 0, 0.0800)]
    return moved(lower + upper, (-0.0187, 0, 0)) + handle(grip, 0.0058, MUSTARD)


def frying_pan():
    pan = dish((0.0770, 0.0008, 0.0127), [(0.0770, 0.0045), (0.0985, 0.0415)], 0.0070, 12, SOOT, BLACK)
    return moved(pan, (0.0075, -0.0008, 0)) + [
        capsule((0.1060, 0, 0.0220), (0.1300, 0, 0.0330), 0.0090, GREY),
        capsule((0.1300, 0, 0.0330), (0.2480, 0, 0.0500), 0.0110, BLACK),
    ]


def moka_pot():
    """A moka pot whose body is as wide as LIBERO's across the flats, so that the gripper fits."""
    return (
        octagon(0.0365, -0.0661, 0.0670)
        + visible(
            cylinder(0.0365, -0.0661, -0.0080, STEEL),
            cylinder(0.0300, -0.0080, 0.0060, STEEL),
            cylinder(0.0350, 0.0060, 0.0640, STEEL),
            cylinder(0.0365, 0.0640, 0.0670, WHITE),
            cylinder(0.0070, 0.0670, 0.0850, BLACK),
        )
        + colliding(slab(0.0052, 0.0060, 0.0670, 0.0850))
        + [box((-0.0080, -0.0550, 0.0420), (0.0080, -0.0330, 0.0620), STEEL)]
        + handle([(0, 0.0330, 0.0580), (0, 0.0780, 0.0580), (0, 0.0780, 0.0080)], 0.0070, BLACK)
    )


def wine_bottle():
    return (
        octagon(0.0212, 0.0011, 0.0680)
        + colliding(slab(0.0118, 0.0118, 0.0680, 0.0881), slab(0.0066, 0.0066, 0.0881, 0.1580))
        + visible(
            cylinder(0.0212, 0.0011, 0.0680, DARK_GREEN),
            cylinder(0.0165, 0.0680, 0.0800, DARK_GREEN),
            cylinder(0.0110, 0.0800, 0.0930, DARK_GREEN),
            cylinder(0.0076, 0.0930, 0.1440, DARK_GREEN),
            cylinder(0.0080, 0.1300, 0.1580, CARDBOARD),
            cylinder(0.0215, 0.0160, 0.0520, CREAM),
        )
    )


def black_book():
    low, high = (-0.0148, -0.0673, 0.0022), (0.0139, 0.0430, 0.1366)
    pages = box((-0.0110, -0.0640, 0.0016), (0.0101, 0.0436, 0.1372), CREAM)
    return [box(low, high, BLACK), *visible(pages)]


def basket():
    x, y, bottom, top, board = 0.0737, 0.0688, 0.0042, 0.1450, 0.0067
    side = [box((x - board, -y - board, bottom), (x + board, y + board, top), CARDBOARD)]
    end = [box((-x + board, y - board, bottom), (x - board, y + board, top), CARDBOARD)]
    rim = board + 0.0006
    edge = visible(box((x - rim, -y - board, top - 0.004), (x + rim, y + board, top + 0.0006), BROWN))
    lip = visible(box((-x, y - rim, top - 0.004), (x, y + rim, top + 0.0006), BROWN))
    long_sides, short_sides = side + edge, end + lip
    return [
        slab(x - board, y - board, bottom, 0.0219, BROWN),
        *long_sides, *turned(long_sides, "z", 180),
        *short_sides, *turned(short_sides, "z", 180),
    ]


CONTAIN_REGION = Site("contain_region", (0, 0, 0.07185), (0.06108, 0.06108, 0.06949), (0, 0, 0, 1))

# Name: (folder, mass in kg, shapes), and a list of sites for an object that has some.
HOUSEHOLD = {
    "akita_black_bowl": (
        SCANNED, 0.00559,
        dish((0.0240, 0.0016, 0.0068), [(0.0225, 0.0050), (0.0405, 0.0165), (0.0497, 0.0515)], 0.0060, 12, BLACK, SOOT),
    ),
    "basket": (SCANNED, 0.13611, basket(), [CONTAIN_REGION]),
    "chefmate_8_frypan": (SCANNED, 0.05025, frying_pan()),
    "glazed_rim_porcelain_ramekin": (
        SCANNED, 0.00966,
        dish((0.0360, 0.0009, 0.0073), [(0.0355, 0.0015), (0.0413, 0.0427)], 0.0050, 12, STEEL),
    ),
    "plate": (
        SCANNED, 0.01152,
        dish((0.0310, -0.0025, 0.0058), [(0.0295, 0.0026), (0.0660, 0.0134)], 0.0060, 16, PORCELAIN, WHITE),
    ),
    "black_book": (TURBOSQUID, 0.04255, black_book()),
    "moka_pot": (TURBOSQUID, 0.06824, moka_pot()),
    "porcelain_mug": (TURBOSQUID, 0.01646, porcelain_mug()),
    "red_coffee_mug": (TURBOSQUID, 0.02935, red_coffee_mug()),
    "white_yellow_mug": (TURBOSQUID, 0.03091, white_yellow_mug()),
    "wine_bottle": (TURBOSQUID, 0.01539, wine_bottle()),
}


def files():
    """Path inside the pack -> contents."""
    out = {}
    for name, (folder, mass, shapes, *sites) in HOUSEHOLD.items():
        root = Part("object", shapes, sites=sites[0] if sites else [])
        out[f"{folder}/{name}/{name}.xml"] = document(name, root, EXTENT, density_for(mass, shapes))
    return out
