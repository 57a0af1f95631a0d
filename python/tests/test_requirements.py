"""The oldest releases of dependencies that the packages accept."""

from importlib.metadata import PackageNotFoundError, requires

import pytest

try:
    REQUIRED = requires("rollout-libero") or []
except PackageNotFoundError:
    pytest.skip("rollout-libero is not installed", allow_module_level=True)


def test_every_gymnasium_that_is_accepted_has_autoreset_modes():
    (gymnasium,) = [line for line in REQUIRED if line.startswith("gymnasium")]
    oldest = gymnasium.partition(">=")[2].split(",")[0]
    # gymnasium.vector.AutoresetMode was introduced in 1.1.
    assert tuple(map(int, oldest.split("."))) >= (1, 1)
