"""The forty tasks: the benchmark's instruction of each, and its grammar."""

from __future__ import annotations

from collections.abc import Mapping

from training.grammar.constructions import (
    CARRY,
    CARRY_BOTH,
    CARRY_FROM,
    OPEN,
    OPEN_AND_PUT,
    PUSH,
    PUT_AND_CLOSE,
    PUT_TWO,
    TURN_ON,
    TURN_ON_AND_PUT,
)
from training.grammar.template import Grammar, Templates
from training.grammar.things import (
    BACK,
    BASKET,
    BBQ_SAUCE,
    BOOK,
    BOTTOM,
    BOWL,
    BUTTER,
    CABINET,
    CADDY,
    COMPARTMENT,
    COOKIE_BOX,
    CREAM_CHEESE,
    DRAWER,
    KETCHUP,
    LEFT_PLATE,
    MICROWAVE,
    MILK,
    MOKA,
    MOKAS,
    ORANGE_JUICE,
    PLAIN_BOWL,
    PLATE,
    PUDDING,
    RACK,
    RAMEKIN,
    RIGHT_PLATE,
    SALAD_DRESSING,
    SOUP,
    STOVE,
    TABLE_CENTER,
    TOMATO_SAUCE,
    TOP,
    WINE,
    YELLOW_MUG,
)
from training.grammar.words import COMMON

# fmt: off
# Lists of words are easier to read with several words to a line.

def _carry_from(*, at: Templates, place: Templates = (), **entries: Templates) -> Grammar:
    """Returns the grammar of a bowl that is carried from a position to the plate.

    Args:
        at: the position, as in "the bowl on the stove".
        place: the position after "from", as in "take the bowl from the stove"; by default ``at``.
        entries: further entries of the grammar."""
    return {
        **COMMON, **CARRY_FROM, "at": at, "place": place or at, "cabinet": CABINET, "stove": STOVE,
        "ramekin": RAMEKIN, "cookie box": COOKIE_BOX, **entries,
    }


def _carry(thing: Templates, to: Templates, towards: Templates, **entries: Templates) -> Grammar:
    """Returns the grammar of an object that is carried to a place."""
    return {
        **COMMON, **CARRY, "thing": thing, "to": to, "towards": towards,
        "x": (
            "the {thing}", "the {thing}", "the {thing}", "the {thing}", "that {thing}", "a {thing}",
            "this {thing}", "the {thing} [you see|over there|there|on the table|lying there]",
        ),
        "a x": ("a {thing}", "the {thing}"), **entries,
    }


_IN_BASKET: Templates = (
    "{in} the {basket}", "{in} the {basket}", "{in} the {basket}", "{in} that {basket}",
    "{in} a {basket}", "{in} this {basket}",
)
_TO_BASKET: Templates = ("to the {basket}", "over to the {basket}", "toward the {basket}")


def _to_basket(thing: Templates) -> Grammar:
    return _carry(
        thing, _IN_BASKET, _TO_BASKET, basket=BASKET,
        do=(
            *CARRY["do"], "add {x} to the {basket}", "[pack|load|toss|throw|stash|pop] {x} {to}",
            "fill the {basket} with {x}",
        ),
        doing=(*CARRY["doing"], "adding {x} to the {basket}", "[packing|loading|tossing] {x} {to}"),
        must=(
            *CARRY["must"], "the {basket} [should|must|needs to] [contain|hold] {x}",
            "the {basket} needs {x}",
        ),
        **{"is": (*CARRY["is"], "the {basket} [contains|holds|has] {x}")},
    )


def _both_to_basket(a: Templates, b: Templates) -> Grammar:
    return {
        **COMMON, **CARRY_BOTH, "thing a": a, "thing b": b,
        "a": ("the {thing a}", "the {thing a}", "the {thing a}", "that {thing a}"),
        "b": ("the {thing b}", "the {thing b}", "the {thing b}", "that {thing b}"),
    }


_ON_CABINET: Templates = (
    "on top of the {cabinet}", "on top of the {cabinet}", "on top of the {cabinet}",
    "{on} the {cabinet}", "{on} the {cabinet}", "on the top of the {cabinet}",
    "onto the top of the {cabinet}", "on the {cabinet}'s top",
    "on the upper surface of the {cabinet}", "on the {cabinet} top", "up on the {cabinet}",
    "on the top surface of the {cabinet}", "on the roof of the {cabinet}",
)
_TO_CABINET: Templates = (
    "to the top of the {cabinet}", "to the {cabinet}'s top", "up to the top of the {cabinet}",
)

TASKS: Mapping[str, tuple[str, Grammar]] = {
    "libero_spatial/0": (
        "pick up the black bowl between the plate and the ramekin and place it on the plate",
        _carry_from(at=(
            "{between} the {plate} and the {ramekin}",
            "{between} the {plate} and the {ramekin}",
            "{between} the {plate} and the {ramekin}",
            "{between} the {ramekin} and the {plate}",
            "{between} the {plate} and {ramekin}",
            "with the {plate} on one side and the {ramekin} on the other",
            "that has the {plate} on one side and the {ramekin} on the other",
            "that the {plate} and the {ramekin} surround",
        ), place=(
            "between the {plate} and the {ramekin}",
            "the space between the {plate} and the {ramekin}",
            "its place between the {ramekin} and the {plate}",
        )),
    ),
    "libero_spatial/1": (
        "pick up the black bowl next to the ramekin and place it on the plate",
        _carry_from(at=("{next to} the {ramekin}",), place=(
            "the side of the {ramekin}", "beside the {ramekin}", "next to the {ramekin}",
            "its place by the {ramekin}", "near the {ramekin}",
        )),
    ),
    "libero_spatial/2": (
        "pick up the black bowl from table center and place it on the plate",
        _carry_from(at=TABLE_CENTER, place=(
            "the [center|centre|middle] of the [table|tabletop]",
            "table [center|centre]",
            "the table's [center|centre|middle]",
            "the [center|centre|middle]",
        )),
    ),
    "libero_spatial/3": (
        "pick up the black bowl on the cookie box and place it on the plate",
        _carry_from(at=(
            "{on} the {cookie box}", "{on} the {cookie box}", "on the top of the {cookie box}",
        ),
                    place=(
                        "the {cookie box}", "the top of the {cookie box}",
                        "on top of the {cookie box}",
                    )),
    ),
    "libero_spatial/4": (
        "pick up the black bowl in the top drawer of the wooden cabinet and place it on the plate",
        _carry_from(at=(
            "[in|inside|within|inside of] the {top} {drawer} of the {cabinet}",
            "[in|inside|within] the {top} {drawer} of the {cabinet}",
            "[in|inside] the {top} {drawer}",
            "[in|inside] the {cabinet}'s {top} {drawer}",
            "[in|inside] the {drawer} at the top of the {cabinet}",
            "[in|inside] the {drawer}",
            "[in|inside] the open {drawer} of the {cabinet}",
            "[in|inside] the {drawer} of the {cabinet}",
            "[in|inside] the {top} {drawer} [in|on] the {cabinet}",
            "[in|inside] the open {top} {drawer}",
            "[in|inside] the {cabinet}",
        ), place=(
            "the {top} {drawer} of the {cabinet}", "inside the {top} {drawer} of the {cabinet}",
            "the {top} {drawer}", "the {cabinet}'s {top} {drawer}", "within the {drawer}",
            "the {drawer} of the {cabinet}",
        ),
                    top=TOP, drawer=DRAWER,
                    do=(
                        *CARRY_FROM["do"],
                        "{take} the {bowl} out of the {top} {drawer} [of the {cabinet} |]{then} "
                        "{put it} {to}",
                        "[take|pull|lift|get] the {bowl} [out of|from inside|from within] the "
                        "{top} {drawer} {then} {put it} {to}",
                    )),
    ),
    "libero_spatial/5": (
        "pick up the black bowl on the ramekin and place it on the plate",
        _carry_from(at=(
            "{on} the {ramekin}", "{on} the {ramekin}", "on the top of the {ramekin}",
            "stacked on the {ramekin}",
        ),
                    place=("the {ramekin}", "the top of the {ramekin}", "on top of the {ramekin}")),
    ),
    "libero_spatial/6": (
        "pick up the black bowl next to the cookie box and place it on the plate",
        _carry_from(at=("{next to} the {cookie box}",), place=(
            "the side of the {cookie box}", "beside the {cookie box}", "next to the {cookie box}",
            "its place by the {cookie box}", "near the {cookie box}",
        )),
    ),
    "libero_spatial/7": (
        "pick up the black bowl on the stove and place it on the plate",
        _carry_from(at=("{on} the {stove}", "{on} the {stove}", "on the top of the {stove}"),
                    place=("the {stove}", "the top of the {stove}", "on top of the {stove}")),
    ),
    "libero_spatial/8": (
        "pick up the black bowl next to the plate and place it on the plate",
        _carry_from(at=("{next to} the {plate}",), place=(
            "the side of the {plate}", "beside the {plate}", "next to the {plate}",
            "its place by the {plate}", "near the {plate}",
        ),
                    to=(
                        *CARRY_FROM["to"], "{on} it", "on that same {plate}", "on the same {plate}",
                        "{on} the {plate} beside it", "{on} the nearby {plate}",
                    )),
    ),
    "libero_spatial/9": (
        "pick up the black bowl on the wooden cabinet and place it on the plate",
        _carry_from(at=(
            "{on} the {cabinet}", "{on} the {cabinet}", "on the top of the {cabinet}",
            "on top of the {cabinet}",
        ),
                    place=("the {cabinet}", "the top of the {cabinet}", "on top of the {cabinet}")),
    ),
    "libero_object/0": ("pick up the alphabet soup and place it in the basket", _to_basket(SOUP)),
    "libero_object/1": ("pick up the cream cheese and place it in the basket",
        _to_basket(CREAM_CHEESE)),
    "libero_object/2": ("pick up the salad dressing and place it in the basket",
        _to_basket(SALAD_DRESSING)),
    "libero_object/3": ("pick up the bbq sauce and place it in the basket", _to_basket(BBQ_SAUCE)),
    "libero_object/4": ("pick up the ketchup and place it in the basket", _to_basket(KETCHUP)),
    "libero_object/5": ("pick up the tomato sauce and place it in the basket",
        _to_basket(TOMATO_SAUCE)),
    "libero_object/6": ("pick up the butter and place it in the basket", _to_basket(BUTTER)),
    "libero_object/7": ("pick up the milk and place it in the basket", _to_basket(MILK)),
    "libero_object/8": ("pick up the chocolate pudding and place it in the basket",
        _to_basket(PUDDING)),
    "libero_object/9": ("pick up the orange juice and place it in the basket",
        _to_basket(ORANGE_JUICE)),
    "libero_goal/0": ("open the middle drawer of the cabinet", {**COMMON, **OPEN}),
    "libero_goal/1": (
        "put the bowl on the stove",
        _carry(PLAIN_BOWL, (
            "{on} the {stove}", "{on} the {stove}", "{on} the {stove}", "{on} that {stove}",
            "on the surface of the {stove}", "on the top of the {stove}",
        ),
               ("to the {stove}", "over to the {stove}"), stove=STOVE),
    ),
    "libero_goal/2": (
        "put the wine bottle on top of the cabinet",
        _carry(WINE, _ON_CABINET, _TO_CABINET, cabinet=CABINET),
    ),
    "libero_goal/3": ("open the top drawer and put the bowl inside", {**COMMON, **OPEN_AND_PUT}),
    "libero_goal/4": (
        "put the bowl on top of the cabinet",
        _carry(PLAIN_BOWL, _ON_CABINET, _TO_CABINET, cabinet=CABINET),
    ),
    "libero_goal/5": ("push the plate to the front of the stove", {**COMMON, **PUSH}),
    "libero_goal/6": (
        "put the cream cheese in the bowl",
        _carry(CREAM_CHEESE, (
            "{in} the {bowl}", "{in} the {bowl}", "{in} the {bowl}", "{in} that {bowl}",
            "{in} a {bowl}", "on the {bowl}",
        ),
               ("to the {bowl}", "over to the {bowl}"), bowl=PLAIN_BOWL,
               do=(
                   *CARRY["do"], "add {x} to the {bowl}", "[toss|pop|fill] {x} {to}",
                   "fill the {bowl} with {x}",
               ),
               must=(
                   *CARRY["must"], "the {bowl} [should|must|needs to] [contain|hold] {x}",
                   "the {bowl} needs {x}",
               ),
               **{"is": (*CARRY["is"], "the {bowl} [contains|holds|has] {x}")}),
    ),
    "libero_goal/7": ("turn on the stove", {**COMMON, **TURN_ON}),
    "libero_goal/8": (
        "put the bowl on the plate",
        _carry(PLAIN_BOWL, (
            "{on} the {plate}", "{on} the {plate}", "{on} the {plate}", "{on} that {plate}",
            "{on} a {plate}", "on the surface of the {plate}", "in the middle of the {plate}",
        ),
               ("to the {plate}", "over to the {plate}"), plate=PLATE),
    ),
    "libero_goal/9": (
        "put the wine bottle on the rack",
        _carry(WINE, (
            "{on} the {rack}", "{on} the {rack}", "{on} the {rack}", "[in|into|inside] the {rack}",
            "[in|into|inside] the {rack}", "{on} that {rack}", "{on} a {rack}",
        ),
               ("to the {rack}", "over to the {rack}"), rack=RACK),
    ),
    "libero_10/0": ("put both the alphabet soup and the tomato sauce in the basket",
        _both_to_basket(SOUP, TOMATO_SAUCE)),
    "libero_10/1": ("put both the cream cheese box and the butter in the basket",
        _both_to_basket(CREAM_CHEESE, BUTTER)),
    "libero_10/2": ("turn on the stove and put the moka pot on it", {**COMMON, **TURN_ON_AND_PUT}),
    "libero_10/3": (
        "put the black bowl in the bottom drawer of the cabinet and close it",
        {**COMMON, **PUT_AND_CLOSE,
         "y": ("the {bowl}", "the {bowl}", "the {bowl}", "that {bowl}", "a {bowl}"),
         "x": (
             "the {bottom} {drawer} of the {cabinet}",
             "the {bottom} {drawer} of the {cabinet}",
             "the {bottom} {drawer}",
             "the {cabinet}'s {bottom} {drawer}",
             "the {drawer} at the bottom",
             "the {drawer} at the bottom of the {cabinet}",
             "the {bottom} {drawer} [in|on|at] the {cabinet}",
             "the {bottom} one of the drawers",
             "the {bottom} {cabinet} {drawer}",
             "the open {bottom} {drawer}",
             "the {cabinet} {drawer} at the bottom",
         ),
         "it": (
             "it", "it", "it", "the {drawer}", "the {drawer}", "that {drawer}",
             "the {bottom} {drawer}",
         ),
         "thing": ("{bottom} {drawer}", "{drawer} at the bottom"),
             "bowl": BOWL, "bottom": BOTTOM, "drawer": DRAWER, "cabinet": CABINET},
    ),
    "libero_10/4": (
        "put the white mug on the left plate and put the yellow and white mug on the right plate",
        {**COMMON, **PUT_TWO, "b": ("the {yellow mug}",), "yellow mug": YELLOW_MUG,
         "to a": (
             "{on} the {left plate}", "{on} the {left plate}", "{on} the {left plate}",
             "on the left",
         ),
         "to b": (
             "{on} the {right plate}", "{on} the {right plate}", "{on} the {right plate}",
             "on the right", "{on} the [other|right] one",
         ),
         "left plate": LEFT_PLATE, "right plate": RIGHT_PLATE},
    ),
    "libero_10/5": (
        "pick up the book and place it in the back compartment of the caddy",
        _carry(BOOK, (
            "{in} the {back} {compartment} of the {caddy}",
            "{in} the {back} {compartment} of the {caddy}",
            "{in} the {back} {compartment} of the {caddy}",
            "{in} the {back} {compartment}",
            "{in} the {caddy}'s {back} {compartment}",
            "{in} the {back} of the {caddy}",
            "{in} the {compartment} at the [back|rear] of the {caddy}",
            "{in} the {compartment} at the [back|rear]",
            "{in} the {caddy}, at the [back|rear]",
            "{in} the {caddy}'s back",
            "{in} the {back} {compartment} [in|on|inside] the {caddy}",
            "at the [back|rear] of the {caddy}",
            "{in} the {caddy}, in the {back} {compartment}",
        ),
               (
                   "to the {back} {compartment} of the {caddy}",
                   "to the {back} of the {caddy}",
                   "to the {caddy}'s {back} {compartment}",
               ),
               caddy=CADDY, back=BACK, compartment=COMPARTMENT,
               do=(
                   *CARRY["do"],
                   "[slide|insert|file|tuck|slip|stand|fit|slot] {x} {to}",
                   "{take} {x} {then} [slide|insert|slip|slot|tuck|fit] it {to}",
               ),
               doing=(*CARRY["doing"], "[sliding|inserting|slipping|fitting] {x} {to}")),
    ),
    "libero_10/6": (
        "put the white mug on the plate and put the chocolate pudding to the right of the plate",
        {**COMMON, **PUT_TWO, "b": ("the {pudding}",), "pudding": PUDDING, "plate": PLATE,
         "to a": ("{on} the {plate}", "{on} the {plate}", "{on} the {plate}", "{on} that {plate}"),
         "to b": (
             "to the right of the {plate}", "to the right of the {plate}",
             "to the right of the {plate}", "right of the {plate}",
             "on the right side of the {plate}", "to the right of it", "on the {plate}'s right",
             "to the {plate}'s right side", "at the right of the {plate}",
             "at the right side of the {plate}", "beside the {plate} on the right",
             "on the right-hand side of the {plate}", "next to the {plate} on the right",
             "to its right", "on its right side", "to the right hand side of the {plate}",
             "right next to the {plate}, on the right side", "on the right of the {plate}",
         )},
    ),
    "libero_10/7": ("put both the alphabet soup and the cream cheese box in the basket",
        _both_to_basket(SOUP, CREAM_CHEESE)),
    "libero_10/8": (
        "put both moka pots on the stove",
        {**COMMON, **CARRY_BOTH, "stove": STOVE, "moka": MOKA, "mokas": MOKAS, "the place": (
            "the {stove}",
        ),
         "both x": (
             "{both} {mokas}", "{both} {mokas}", "both {mokas}", "both {mokas}",
             "both of the {mokas}", "the two {mokas}", "the {mokas}", "the {mokas}, both of them,",
             "all {mokas}", "one {moka} and then the other", "both the {mokas}",
             "a {moka} and the other {moka}", "the first {moka} and the second {moka}",
         ),
         "a": (
             "one {moka}", "the first {moka}", "one of the {mokas}", "the left {moka}", "a {moka}",
         ),
         "b": (
             "the other one", "the other {moka}", "the second one", "the second {moka}",
             "the other", "the remaining {moka}", "another {moka}",
         ),
         "to": (
             "{on} the {stove}", "{on} the {stove}", "{on} the {stove}", "{on} that {stove}",
             "on the surface of the {stove}", "on the same {stove}", "side by side on the {stove}",
             "on the {stove} together",
         ),
         "towards": ("to the {stove}", "over to the {stove}")},
    ),
    "libero_10/9": (
        "put the yellow and white mug in the microwave and close it",
        {**COMMON, **PUT_AND_CLOSE, "y": (
            "the {yellow mug}", "the {yellow mug}", "the {yellow mug}", "that {yellow mug}",
            "a {yellow mug}",
        ),
         "x": (
             "the {microwave}", "the {microwave}", "the {microwave}", "that {microwave}",
             "the {microwave} on the table",
         ),
         "it": (
             "it", "it", "it", "the {microwave}", "its door", "the door", "the {microwave} door",
             "the door of the {microwave}", "the {microwave}'s door",
         ),
         "thing": ("{microwave}",), "yellow mug": YELLOW_MUG, "microwave": MICROWAVE},
    ),
}
