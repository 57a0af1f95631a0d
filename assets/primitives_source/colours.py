"""The palette: plain colours by name, red green blue from 0 to 1."""

from typing import NamedTuple


class Colour(NamedTuple):
    name: str
    rgb: tuple


BLACK = Colour("black", (0.07, 0.07, 0.08))
BLUE = Colour("blue", (0.14, 0.30, 0.66))
BROWN = Colour("brown", (0.42, 0.24, 0.12))
CARDBOARD = Colour("cardboard", (0.72, 0.52, 0.32))
CHOCOLATE = Colour("chocolate", (0.30, 0.17, 0.10))
CREAM = Colour("cream", (0.95, 0.91, 0.78))
DARK_GREEN = Colour("dark_green", (0.08, 0.28, 0.15))
DARK_RED = Colour("dark_red", (0.45, 0.08, 0.06))
DARK_WOOD = Colour("dark_wood", (0.21, 0.15, 0.11))
WALNUT = Colour("walnut", (0.31, 0.22, 0.17))
GREEN = Colour("green", (0.16, 0.50, 0.22))
GREY = Colour("grey", (0.45, 0.46, 0.48))
LIGHT_WOOD = Colour("light_wood", (0.78, 0.70, 0.62))
MUSTARD = Colour("mustard", (0.80, 0.64, 0.13))
OAK = Colour("oak", (0.49, 0.36, 0.21))
ORANGE = Colour("orange", (0.93, 0.50, 0.10))
PALE_GREEN = Colour("pale_green", (0.62, 0.74, 0.52))
PORCELAIN = Colour("porcelain", (0.90, 0.90, 0.88))
RED = Colour("red", (0.78, 0.10, 0.09))
SOOT = Colour("soot", (0.16, 0.16, 0.17))
STEEL = Colour("steel", (0.72, 0.73, 0.75))
WHITE = Colour("white", (0.96, 0.96, 0.96))
YELLOW = Colour("yellow", (0.95, 0.78, 0.16))
