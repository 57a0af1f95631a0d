"""Imports between the files of this package."""

import ast
import pathlib

import rollout_policies

PACKAGE = pathlib.Path(rollout_policies.__file__).parent


def module_name(path):
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported_by(path, modules):
    """Yields the modules of a file's relative imports, including those for type checkers only."""
    package = path.relative_to(PACKAGE.parent).parts[:-1]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level:
            parts = package[: len(package) - node.level + 1]
            base = ".".join([*parts, *filter(None, [node.module])])
            names = {f"{base}.{alias.name}" for alias in node.names}
            yield from names & modules or {base}


def test_there_is_no_import_cycle():
    paths = {module_name(path): path for path in PACKAGE.rglob("*.py")}
    remaining = {name: set(imported_by(path, paths.keys())) for name, path in paths.items()}
    assert {"rollout_policies.policy"} <= remaining["rollout_policies.server"]
    # Repeatedly removes the files that import none of the others.
    while leaves := [
        name for name, imported in remaining.items() if not imported & remaining.keys()
    ]:
        for name in leaves:
            del remaining[name]
    assert not remaining, f"these files import one another in a cycle: {sorted(remaining)}"
