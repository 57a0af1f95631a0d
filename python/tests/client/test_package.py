"""The package without a coordinator."""

from .conftest import in_a_process

WITHOUT_PANDAS = """
import sys
sys.modules["pandas"] = None
import rollout_client
"""

IMPORTED = """
import sys
import rollout_client
print(sorted(name for name in sys.modules if name.startswith("rollout_")), file=sys.stderr)
"""


def test_without_pandas_the_error_says_what_to_install():
    with in_a_process(WITHOUT_PANDAS) as process:
        _, errors = process.communicate(timeout=60)
    assert process.returncode != 0
    assert "rollout_client needs pandas: run pip install grpcio protobuf pandas" in errors


def test_the_client_does_not_load_the_simulator():
    with in_a_process(IMPORTED) as process:
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    assert "'rollout_client.client'" in errors
    assert "rollout_libero" not in errors
