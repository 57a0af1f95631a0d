"""The Python code in the documents runs unchanged."""

from pathlib import Path

import pytest

pytest.importorskip("rollout_libero", reason="rollout-libero is not installed")

ROOT = Path(__file__).resolve().parents[2]
PAGES = ("docs/PYTHON.md", "python/README.md", "python/libero_shim/README.md")


def blocks():
    """Yields the documents' programs that need only the wheels. A block with `file:` before it is a
    file of a shell session, and is left out."""
    for page in PAGES:
        text = (ROOT / page).read_text()
        pieces = text.split("```python\n")
        for before, after in zip(pieces, pieces[1:], strict=False):
            program = after.split("```")[0]
            if "file:" not in before.strip().splitlines()[-1]:
                yield pytest.param(program, id=f"{page}:{program.splitlines()[-1][:40]}")


@pytest.mark.parametrize("program", blocks())
def test_a_documents_code_block_runs(program, python):
    done = python("-c", program, ROLLOUT_ASSETS="primitives")
    assert done.returncode == 0, done.stderr
