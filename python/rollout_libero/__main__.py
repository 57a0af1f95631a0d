"""``python -m rollout_libero fetch``: fetches what scenes are made of."""

from __future__ import annotations

import argparse
import sys

from rollout_libero import files


def main() -> int:
    """Fetches what the command line asks for."""
    parser = argparse.ArgumentParser(prog="python -m rollout_libero", description=__doc__)
    parser.add_argument("command", choices=["fetch"], help="fetch LIBERO's assets, and check them")
    parser.parse_args()
    print(files.sources())
    return 0


if __name__ == "__main__":
    sys.exit(main())
