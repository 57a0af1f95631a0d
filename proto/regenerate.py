"""Generates the Python code of the .proto files in the packages that contain it.

The generated files are kept under version control, so that installing a package
needs no protocol compiler; `python proto/regenerate.py --check` fails if they
do not match the .proto files.

The generator is pinned to grpcio-tools 1.62.3, the last series whose output
runs with every protobuf from 3.20 on and does not require a particular grpcio:
the versions in these packages' environments are chosen by other packages.
"""

import argparse
import pathlib
import re
import sys
import tempfile
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

GENERATOR = "1.62.3"
HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent


@dataclass(frozen=True)
class Generated:
    """The code of one .proto file in one package."""

    #: The .proto file, relative to this folder.
    source: str
    #: The folder that holds the package, relative to the checkout.
    sources: str
    #: The package's folder below `sources`.
    package: str
    #: True if type stubs are kept beside the code.
    has_stubs: bool

    def files(self) -> list[str]:
        """Returns the names of the generated files, below `sources`."""
        stem = f"{self.package}/{pathlib.Path(self.source).stem}_pb2"
        return [f"{stem}.py"] + [f"{stem}.pyi"] * self.has_stubs


PACKAGES = (
    Generated(
        "rollout/policy/v1/policy.proto", "policies/src", "rollout_policies/proto", has_stubs=False
    ),
    Generated(
        "rollout/coordinator/v1/coordinator.proto", "python", "rollout_client/proto", has_stubs=True
    ),
)


def generate(wanted: Generated, folder: pathlib.Path) -> None:
    """Writes a package's generated files below `folder`."""
    from grpc_tools import protoc

    source = HERE / wanted.source
    # The virtual path makes the generated imports name the package.
    arguments = ["protoc", f"-I{wanted.package}={source.parent}", f"--python_out={folder}"]
    if wanted.has_stubs:
        arguments.append(f"--pyi_out={folder}")
    status = protoc.main([*arguments, f"{wanted.package}/{source.name}"])
    if status != 0:
        sys.exit(f"failed to generate from {source}: protoc exited with {status}")
    code = folder / wanted.files()[0]
    # Positions in the serialized descriptor, which only copying descriptors in pure Python reads.
    code.write_text(re.sub(r"  _globals\[.*_serialized_(start|end)=\d+\n", "", code.read_text()))


def stale(wanted: Generated, folder: pathlib.Path) -> list[str]:
    """Returns the version-controlled files, relative to the checkout, that differ from those
    below `folder`."""
    kept = ROOT / wanted.sources
    return [
        f"{wanted.sources}/{name}"
        for name in wanted.files()
        if not (kept / name).exists() or (kept / name).read_bytes() != (folder / name).read_bytes()
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="compare only; exit 1 if stale")
    arguments = parser.parse_args()
    try:
        installed = version("grpcio-tools")
    except PackageNotFoundError:
        installed = "none"
    if installed != GENERATOR:
        sys.exit(
            f"failed to find the generator: grpcio-tools {GENERATOR} is needed, {installed} is"
            f" installed; run: pip install 'grpcio-tools=={GENERATOR}' 'setuptools<81'"
        )
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        names = []
        for wanted in PACKAGES:
            generate(wanted, folder)
            for path in stale(wanted, folder):
                names.append(path)
                if not arguments.check:
                    fresh = folder / path.removeprefix(f"{wanted.sources}/")
                    (ROOT / path).write_bytes(fresh.read_bytes())
                    print(f"wrote {path}")
        if arguments.check and names:
            sys.exit(f"stale: {', '.join(names)}; run: python {HERE.name}/regenerate.py")


if __name__ == "__main__":
    main()
