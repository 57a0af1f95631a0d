"""Many wordings of each of the forty tasks, drawn from ``grammar``.

Wordings exclude the sentences of the evaluation's language axis: ``data/held_out.txt`` has digests
of these sentences, and a sentence with the same words as one of them is drawn again."""

from __future__ import annotations

import hashlib
import random
import re
from functools import cache
from pathlib import Path

from training.grammar import FRAMES, TASKS, Grammar, Templates
from training.text import words

TASK_NAMES: tuple[str, ...] = tuple(TASKS)
"""``libero_spatial/0`` to ``libero_10/9``; shards store a task as its index in this tuple."""

UNFRAMED = 0.45
"""Share of the imperatives that have no frame such as "please" or "your task is to"."""
MAX_PLAIN = 0.8
"""Greatest probability that a slot of a sentence takes its first option without a draw."""
KINDS = {"do": 0.6, "doing": 0.1, "must": 0.18, "is": 0.12}
"""Probability of each kind of clause."""

_HELD_OUT = Path(__file__).parent / "data" / "held_out.txt"
_INNERMOST_CHOICE = re.compile(r"\[([^\[\]]*)\]")
_SLOT = re.compile(r"\{([^{}]+)\}")


def canonical(task: str) -> str:
    """Returns the benchmark's own instruction for a task."""
    return TASKS[task][0]


def draw(task: str, count: int, seed: int) -> list[str]:
    """Returns ``count`` different wordings of a task; the first is the benchmark's instruction.

    Raises:
        ValueError: if the grammar gives fewer wordings."""
    rng = random.Random(f"{seed} {task}")
    held_out = held_out_digests()
    by_digest = {digest(canonical(task)): canonical(task)}
    tries = 0
    while len(by_digest) < count:
        text = sentence(task, rng)
        key = digest(text)
        if key not in held_out:
            by_digest.setdefault(key, text)
        tries += 1
        if tries > 20 * count + 1_000:
            raise ValueError(
                f"failed to draw {count} wordings of {task}: the grammar gave {len(by_digest)} in "
                f"{tries} tries; ask for fewer, or add words to the grammar"
            )
    return list(by_digest.values())


def sentence(task: str, rng: random.Random) -> str:
    """Draws a wording of a task."""
    grammar = TASKS[task][1]
    kind = rng.choices(list(KINDS), list(KINDS.values()))[0]
    frame = "{do}" if kind == "do" and rng.random() < UNFRAMED else rng.choice(FRAMES[kind])
    # Some sentences keep nearly all of the benchmark's words, others almost none.
    plain = rng.uniform(0.0, MAX_PLAIN)
    return _tidy(_expand(_choose_options(frame, rng), grammar, rng, plain))


def digest(text: str) -> str:
    """Returns a digest that is equal for texts with the same words in the same order."""
    return hashlib.sha256(" ".join(words(text)).encode()).hexdigest()[:16]


@cache
def held_out_digests() -> frozenset[str]:
    """Returns digests of the sentences that training must exclude."""
    return frozenset(_HELD_OUT.read_text().split())


def _expand(template: str, grammar: Grammar, rng: random.Random, plain: float) -> str:
    """Fills all slots. With probability ``plain``, a slot takes its first option."""
    while slot := _SLOT.search(template):
        options: Templates = grammar[slot[1]]
        option = options[0] if rng.random() < plain else rng.choice(options)
        filled = _choose_options(option, rng)
        template = template[: slot.start()] + filled + template[slot.end() :]
    return template


def _choose_options(template: str, rng: random.Random) -> str:
    """Replaces each pair of brackets, the innermost first, by one of its options."""
    while choice := _INNERMOST_CHOICE.search(template):
        option = rng.choice(choice[1].split("|"))
        template = template[: choice.start()] + option + template[choice.end() :]
    return template


def _tidy(text: str) -> str:
    """Removes spaces and punctuation that empty options leave, and corrects "a" before a, e, i or o
    to "an"."""
    text = re.sub(r"\s+", " ", text)
    text = re.sub(r" ([,.;:?])", r"\1", text)
    text = re.sub(r"[,;]+([.,;:?])", r"\1", text)
    text = re.sub(r"([:;.]),", r"\1", text)
    text = re.sub(r"\ba (?=[aeio])", "an ", text)
    return text.strip(" ,;")
