"""Writes digests of the evaluation's wordings, so that training can exclude these wordings.

python -m training.held_out"""

import json
from pathlib import Path

from training.wordings import TASK_NAMES, canonical, digest

LEVELS = ("L1", "L2", "L3")
CONFIGURATIONS = 10
"""Number of the benchmark's own configurations on each axis and level."""


def evaluation_sentences() -> list[str]:
    """Returns the benchmark's wordings on the language axis and under all axes together, except the
    canonical instructions."""
    from rollout_libero._library import native

    sentences = set()
    for task in TASK_NAMES:
        suite, index = task.split("/")
        for level in LEVELS:
            for config in range(CONFIGURATIONS):
                for axis in ("language", "simultaneous"):
                    name = f"{suite}/t{index}/{axis}/{level}/c{config:02}"
                    sentences.add(str(json.loads(native.configuration_row(name))["language"]))
    return sorted(sentences - {canonical(task) for task in TASK_NAMES})


def main() -> None:
    file = Path(__file__).parent / "data" / "held_out.txt"
    digests = sorted({digest(text) for text in evaluation_sentences()})
    file.write_text("\n".join(digests) + "\n")
    print(f"{len(digests)} digests in {file}")


if __name__ == "__main__":
    main()
