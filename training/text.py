"""Conversion of instructions to the network's input: hashed words and pairs of neighbouring
words."""

import re
from functools import lru_cache
from itertools import pairwise

BUCKETS = 4096
"""Number of rows of the network's table, to which words and pairs are hashed."""

_WORD = re.compile(r"[a-z0-9]+")


def words(text: str) -> list[str]:
    """Returns the words of a text: maximal runs of a–z and 0–9, in lower case."""
    # Only ASCII letters are lowered: str.lower would turn the Kelvin sign into an ASCII "k".
    lowered = "".join(character.lower() if character.isascii() else character for character in text)
    return _WORD.findall(lowered)


def fnv1a(text: str) -> int:
    """Returns the 32-bit FNV-1a hash of a text's UTF-8 bytes."""
    value = 0x811C9DC5
    for byte in text.encode():
        value = ((value ^ byte) * 0x01000193) & 0xFFFFFFFF
    return value


@lru_cache(maxsize=1 << 18)
def bucket(feature: str) -> int:
    """Returns the table's row for a word, or for two words joined by one space."""
    return fnv1a(feature) % BUCKETS


def features(text: str) -> tuple[list[int], list[int]]:
    """Returns the table's rows of a text's n words, and of its n - 1 pairs of neighbours."""
    singles = words(text)
    pairs = [f"{first} {second}" for first, second in pairwise(singles)]
    return [bucket(word) for word in singles], [bucket(pair) for pair in pairs]
