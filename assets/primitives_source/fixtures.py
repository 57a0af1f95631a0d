"""The furniture that stays where it is, and what of it moves: drawers, the stove's knob.

Joints, region sites and their places are facts of LIBERO: goals are measured against them. The
boards between them are this pack's own.
"""

from colours import *
from mjcf import Extent, Joint, Part, Site, document
from shapes import box, capsule, cylinder, felt, moved, octagon, seen

# Density of the boards in kg/m³. They never move; it only keeps their mass finite.
DENSITY = 100

USUAL = Extent(bottom=-0.045, top=0.045, radius=0.045, site_size=0.05)

# Mass in kg and moment of inertia in kg m² that LIBERO gives to everything that slides or turns:
# large, so that a push moves it slowly.
HEAVY = (3, 1)

QUARTER_ABOUT_Y = (0.70711, 0, 0.70711, 0)
QUARTER_ABOUT_Z = (0.70711, 0, 0, 0.70711)


def cabinet(body, front, handle):
    """A chest of three drawers that open towards -y."""
    base = Part(
        "base",
        [
            box((-0.1234, 0.1071, 0.0046), (0.1312, 0.1117, 0.2201), body),
            box((-0.1234, -0.0790, 0.0046), (-0.1070, 0.1071, 0.2201), body),
            box((0.1138, -0.0790, 0.0046), (0.1312, 0.1071, 0.2201), body),
            box((-0.1070, -0.0600, 0.0046), (0.1138, 0.1071, 0.0102), body),
            box((-0.1070, -0.0600, 0.0784), (0.1138, 0.1071, 0.0801), body),
            box((-0.1070, -0.0600, 0.1485), (0.1138, 0.1071, 0.1502), body),
            box((-0.1234, -0.0790, 0.2201), (0.1312, 0.1117, 0.2230), body),
        ],
        sites=[Site("top_side", (0.00354, 0.01567, 0.22152), (0.12534, 0.09438, 0.00147))],
    )
    for level, bottom, region in (("top", 0.1511, 0.18563), ("middle", 0.0814, 0.11690), ("bottom", 0.0128, 0.04701)):
        base.parts.append(drawer(level, bottom, region, front, handle))
    return Part("object", parts=[base])


def drawer(level, bottom, region, front, handle):
    """An open box behind a front with a bar handle; `bottom` is the height of its underside."""
    top, grip = bottom + 0.0640, bottom + 0.0300
    bar = [(x, -0.1016, grip) for x in (-0.0473, 0.0417)]
    posts = [((x, -0.0780, grip), (x, -0.1016, grip)) for x in (-0.0356, 0.0292)]
    return Part(
        f"cabinet_{level}",
        [
            box((-0.1060, -0.0780, bottom - 0.0020), (0.1127, -0.0715, bottom + 0.0662), front),
            box((-0.1043, 0.0872, bottom), (0.1113, 0.0943, top), front),
            box((-0.1043, -0.0715, bottom), (-0.0995, 0.0872, top), front),
            box((0.1065, -0.0715, bottom), (0.1113, 0.0872, top), front),
            box((-0.1043, -0.0715, bottom), (0.1113, 0.0872, bottom + 0.0080), front),
            capsule(*bar, 0.0077, handle),
            *(capsule(*post, 0.0052, handle) for post in posts),
        ],
        sites=[Site(f"{level}_region", (0.00328, 0.01128, region), (0.02993, 0.07561, 0.10224), QUARTER_ABOUT_Y)],
        joint=Joint(f"{level}_level", "slide", (0, 1, 0), (-0.16, 0.01), damping=50),
        inertia=HEAVY,
    )


def flat_stove():
    """One burner and a knob that turns it on; LIBERO lights the site `burner` when it is on."""
    grate = [capsule((x, -0.058, 0.0232), (x, 0.058, 0.0232), 0.0022, GREY) for x in (-0.03, 0, 0.03)]
    burner = Part(
        "burner",
        [
            box((-0.095, -0.095, -0.02), (0.095, 0.095, 0.02), STEEL),
            *felt(box((-0.095, -0.095, 0.0245), (0.095, 0.095, 0.0255))),
        ],
        sites=[
            Site("cook_region", (0, 0, 0), (0.075, 0.075, 0.0025)),
            Site("burner", (0, 0, 0.022), (0.0625, 0.0005), kind="cylinder", rgba=(0.9, 0.05, 0.05, 1)),
        ],
        parts=[Part("burner_plate", seen(cylinder(0.065, 0.019, 0.021, SOOT), *grate))],
        pos=(0.15, 0, 0),
        felt_as="plate",
    )
    dial = [*octagon(0.0470, 0.0004, 0.0128), *seen(cylinder(0.0455, 0.0004, 0.0128, SOOT))]
    knob = Part(
        "button",
        [
            *moved(dial, (0.0013, 0.0043, 0)),
            box((-0.0110, -0.0172, 0.0128), (0.0135, 0.0520, 0.0500), BLACK),
            box((-0.0110, -0.0405, 0.0128), (0.0135, -0.0172, 0.0420), BLACK),
        ],
        joint=Joint("button", "hinge", (0, 0, 1), (-0.005, 2.1), damping=1),
        inertia=HEAVY,
        quat=QUARTER_ABOUT_Z,
    )
    return Part("object", parts=[Part("base", parts=[burner, knob])])


def files():
    """Path inside the pack -> contents."""
    # The plate of the stove has MuJoCo's default contact constants.
    plate = {"plate": {"group": "0"}}
    fixtures = {
        "flat_stove": (flat_stove(), USUAL, plate),
        "white_cabinet": (cabinet(PORCELAIN, WHITE, GREY), USUAL, {}),
        "wooden_cabinet": (cabinet(DARK_WOOD, DARKER_WOOD, GREY), USUAL, {}),
    }
    return {
        f"articulated_objects/{name}.xml": document(name, root, extent, DENSITY, classes)
        for name, (root, extent, classes) in fixtures.items()
    }
