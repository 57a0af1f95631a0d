"""The fixtures, which stay in place, and their moving parts: drawers, knob, oven door.

Joints, region sites and their positions are LIBERO's, because goals are measured against them. The
shapes around them are this pack's own."""

from colours import *
from mjcf import Extent, Joint, Part, Site, density_for, document, number
from shapes import box, capsule, colliding, cylinder, moved, octagon, slab, turned, visible

# Density of the boards in kg/m³. It has no effect: the fixtures never move, and their moving parts
# have masses of their own.
DENSITY = 100

# Extent of cabinets and of the stove, for the placement sampler.
CHEST = Extent(bottom=-0.045, top=0.045, radius=0.045, site_size=0.05)

# Mass in kg and moment of inertia in kg m² that LIBERO gives to the cabinets' drawers and to the
# stove's knob: large, so that pushed parts move slowly.
HEAVY = (3, 1)

HALF_ABOUT_Y = (0, 0, 1, 0)
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
    """An open box behind a front with a bar handle; `bottom` is the height of the box's underside,
    `region` that of the centre of the region inside."""
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
    """One burner and a knob that turns it on; LIBERO shows the site `burner` while the burner is on."""
    grate = [capsule((x, -0.058, 0.0232), (x, 0.058, 0.0232), 0.0022, GREY) for x in (-0.03, 0, 0.03)]
    burner = Part(
        "burner",
        [
            *visible(box((-0.095, -0.095, -0.02), (0.095, 0.095, 0.02), STEEL)),
            # Higher than the visible steel, so that objects stand on the grate.
            *colliding(box((-0.095, -0.095, -0.02), (0.095, 0.095, 0.0255))),
        ],
        sites=[
            Site("cook_region", (0, 0, 0), (0.075, 0.075, 0.0025)),
            Site("burner", (0, 0, 0.022), (0.0625, 0.0005), kind="cylinder", rgba=(0.9, 0.05, 0.05, 1)),
        ],
        parts=[Part("burner_plate", visible(cylinder(0.065, 0.019, 0.021, SOOT), *grate))],
        pos=(0.15, 0, 0),
        collision_class="plate",
    )
    dial = [*octagon(0.0470, 0.0004, 0.0128), *visible(cylinder(0.0455, 0.0004, 0.0128, SOOT))]
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


def microwave():
    """An oven with its door hinged on the left. As in LIBERO, door and housing do not collide with
    each other."""
    side, back, floor, roof, depth = -0.1435, 0.0805, 0.0240, 0.1680, -0.0880
    housing = [
        box((-0.1725, depth, 0), (side, 0.1105, 0.1870), SOOT),
        box((0.0635, depth, 0), (0.1725, 0.1105, 0.1870), SOOT),
        box((side, back, 0), (0.0635, 0.1105, 0.1870), SOOT),
        box((side, depth, roof), (0.0635, back, 0.1870), SOOT),
        box((side, depth, 0), (0.0635, back, floor), SOOT),
        box((0.0875, -0.1105, 0), (0.1725, depth, 0.1870), BLACK),
    ]
    buttons = [box((0.1000, -0.1120, z), (0.1600, -0.1105, z + 0.0180), GREY) for z in (0.0300, 0.0600, 0.0900)]
    grip = ((-0.0250, 0.0650), (-0.0540, 0.0650), (-0.0540, -0.0650), (-0.0250, -0.0650))
    corners = [(0.2375, y, z) for y, z in grip]
    door = Part(
        "microdoorroot",
        [
            box((0.0005, -0.0250, -0.0925), (0.2590, -0.0010, 0.0925), BLACK),
            *visible(box((0.0400, -0.0256, -0.0600), (0.2050, -0.0004, 0.0600), GREY)),
            *(capsule(start, end, 0.0100, STEEL) for start, end in zip(corners, corners[1:])),
        ],
        joint=Joint("microjoint", "hinge", (0, 0, 1), (-2.094, 0), damping=0.5),
        pos=(-0.1725, -0.0880, 0.0960),
        collision_class="door",
    )
    root = Part(
        "object",
        housing + visible(*buttons),
        sites=[
            Site("top_side", (0, 0.01, 0.2), (0.12, 0.0835, 0.005), rgba=(1, 0, 0, 0)),
            Site("heating_region", (0, 0.01, 0.096), (0.12, 0.0835, 0.08), rgba=(1, 0, 0, 0)),
        ],
        parts=[door],
        collision_class="housing",
    )
    # Soft contacts with a margin, between the oven and other bodies but not among the oven's own parts.
    contact = {"group": "0", "contype": "0", "margin": "0.001", "solref": "0.02 1", "solimp": "0.8 0.9 0.01"}
    classes = {
        "housing": {**contact, "density": number(density_for(3, housing))},
        "door": {**contact, "density": number(density_for(0.26, door.shapes))},
    }
    return root, classes


def wine_rack():
    """Two shelves that slope down towards -y, each with a stopper at its lower edge, on a stand.

    A goal places a bottle on the upper shelf, along x."""
    board = slab(0.1344, 0.0789, -0.0045, 0.0045, LIGHT_WOOD)
    stopper = box((-0.1322, -0.0789, 0.0045), (0.1322, -0.0767, 0.0174), BROWN)
    slope = turned([board, stopper], "x", 31.3)
    mast = turned([slab(0.0076, 0.0090, -0.1600, 0.1600, BROWN)], "x", -15.8)
    return Part(
        "object",
        moved(slope, (0, -0.0061, 0.2512))
        + moved(slope, (0, -0.0427, 0.1273))
        + moved(mast, (0, 0.0089, 0.1703))
        + [slab(0.0900, 0.1240, 0.0021, 0.0111, BROWN), slab(0.0905, 0.0140, 0.0111, 0.0250, BROWN)],
        sites=[Site("top_region", (0, -0.08003, 0.21745), (0.10087, 0.022, 0.00251), (0.85491, -0.51877, 0, 0))],
    )


def desk_caddy():
    """A desk organiser with a deep compartment at each end and, between them, a low compartment at
    the front (-x) and a book-sized compartment at the back."""
    def board(low, high):
        return box(low, high, CARDBOARD)

    def stepped_side(y):
        """A side that is low at the front and high at the back."""
        return [
            board((-0.0628, y, 0.0200), (0.0628, y + 0.0072, 0.0785)),
            board((-0.0100, y, 0.0785), (0.0628, y + 0.0072, 0.1200)),
            board((0.0250, y, 0.1200), (0.0628, y + 0.0072, 0.1640)),
        ]

    return Part(
        "object",
        [
            # The floor is thick, so that a book standing on it is inside the goal's region; 15 mm would suffice.
            slab(0.0755, 0.2169, 0.0014, 0.0200, BROWN),
            board((0.0628, -0.2156, 0.0200), (0.0708, 0.2120, 0.1680)),
            board((-0.0709, -0.0631, 0.0200), (-0.0628, 0.2120, 0.0741)),
            board((-0.0709, -0.2156, 0.0200), (-0.0628, -0.0631, 0.1673)),
            board((-0.0628, -0.0742, 0.0200), (0.0628, -0.0618, 0.1674)),
            board((-0.0628, -0.2156, 0.0200), (0.0628, -0.2032, 0.1674)),
            board((-0.0056, -0.0618, 0.0200), (0.0025, 0.0670, 0.0986)),
            *stepped_side(0.0670),
            *stepped_side(0.2048),
        ],
        sites=[
            Site("right_contain_region", (0.00631, -0.14339, 0.06558), (0.06196, 0.06216, 0.06046), HALF_ABOUT_Y),
            Site("left_contain_region", (0.00631, 0.14551, 0.06558), (0.06196, 0.06216, 0.06046), HALF_ABOUT_Y),
            Site("back_contain_region", (0.03364, -0.00064, 0.08558), (0.02775, 0.06216, 0.06046), HALF_ABOUT_Y),
            Site(
                "front_contain_region", (-0.03102, -0.00064, 0.04054), (0.02775, 0.03595, 0.06216),
                (0, 0, 0.70711, -0.70711),
            ),
        ],
    )


def files():
    """Path inside the pack -> contents."""
    oven, oven_classes = microwave()
    # The plate of the stove has MuJoCo's default density and contact constants.
    plate = {"plate": {"group": "0"}}
    shelf_extent = Extent(bottom=-0.06, top=0.04, radius=0.025)
    fixtures = {
        "articulated_objects/flat_stove": (flat_stove(), CHEST, plate),
        "articulated_objects/microwave": (oven, Extent(bottom=-0.06, top=0.06, radius=0.015), oven_classes),
        "articulated_objects/white_cabinet": (cabinet(PORCELAIN, WHITE, GREY), CHEST, {}),
        "articulated_objects/wooden_cabinet": (cabinet(DARK_WOOD, WALNUT, GREY), CHEST, {}),
        "turbosquid_objects/desk_caddy/desk_caddy": (desk_caddy(), shelf_extent, {}),
        "turbosquid_objects/wine_rack/wine_rack": (wine_rack(), shelf_extent, {}),
    }
    return {
        f"{path}.xml": document(path.rsplit("/", 1)[1], root, extent, DENSITY, classes)
        for path, (root, extent, classes) in fixtures.items()
    }
