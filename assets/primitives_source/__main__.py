"""Writes the `primitives` asset pack, or checks that the committed pack is up to date.

    python3 assets/primitives_source            # write
    python3 assets/primitives_source --check    # exit 1 and name the files that differ

Python 3.10 or newer, standard library only. README.md of the pack describes the result.
"""

import argparse
import pathlib
import sys

import arenas
import fixtures
import groceries
import household

PACK = pathlib.Path(__file__).resolve().parent.parent / "primitives"
# Files of the pack that are written by hand.
BY_HAND = {"README.md"}


def main():
    parser = argparse.ArgumentParser(prog="primitives_source", description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="change nothing; exit 1 if anything differs")
    wanted = {**arenas.files(), **fixtures.files(), **groceries.files(), **household.files()}
    if parser.parse_args().check:
        return check(wanted)
    for path, contents in wanted.items():
        file = PACK / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(contents)
    print(f"wrote {len(wanted)} files to {PACK}")
    return 0


def check(wanted):
    """Compares the committed pack with the generated files; returns the exit code."""
    present = {file.relative_to(PACK).as_posix() for file in PACK.rglob("*") if file.is_file()} - BY_HAND
    problems = [f"missing: {path}" for path in wanted.keys() - present]
    problems += [f"not written by the generator: {path}" for path in present - wanted.keys()]
    problems += [f"differs: {path}" for path in wanted.keys() & present if (PACK / path).read_bytes() != wanted[path]]
    for problem in sorted(problems):
        print(problem, file=sys.stderr)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
