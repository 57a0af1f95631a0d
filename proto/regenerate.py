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
from importlib.metadata import PackageNotFoundError, version

GENERATOR = "1.62.3"
HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent


#: For each .proto file: the folder that holds the package of its code, relative to the checkout,
#: the package's folder below, and the endings of the generated files.
PACKAGES = {
    "rollout/policy/v1/policy.proto": ("policies/src", "rollout_policies/proto", (".py",)),
    "rollout/coordinator/v1/coordinator.proto": ("python", "rollout_client/proto", (".py", ".pyi")),
}


def generate(proto: str, folder: pathlib.Path) -> dict[pathlib.Path, bytes]:
    """Generates a package's files below `folder`; returns their contents by place."""
    from grpc_tools import protoc

    source, (sources, package, endings) = HERE / proto, PACKAGES[proto]
    # The virtual path makes the generated imports name the package.
    arguments = ["protoc", f"-I{package}={source.parent}", f"--python_out={folder}"]
    if ".pyi" in endings:
        arguments.append(f"--pyi_out={folder}")
    status = protoc.main([*arguments, f"{package}/{source.name}"])
    if status != 0:
        sys.exit(f"failed to generate from {source}: protoc exited with {status}")
    stem = f"{package}/{source.stem}_pb2"
    contents = {end: (folder / f"{stem}{end}").read_bytes() for end in endings}
    # Positions in the serialized descriptor, which only copying descriptors in pure Python reads.
    positions = rb"  _globals\[.*_serialized_(start|end)=\d+\n"
    contents[".py"] = re.sub(positions, b"", contents[".py"])
    place = ROOT / sources
    return {place / f"{stem}{end}": content for end, content in contents.items()}


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
    stale = []
    with tempfile.TemporaryDirectory() as folder:
        for proto in PACKAGES:
            for file, content in generate(proto, pathlib.Path(folder)).items():
                if file.exists() and file.read_bytes() == content:
                    continue
                stale.append(str(file.relative_to(ROOT)))
                if not arguments.check:
                    file.write_bytes(content)
                    print(f"wrote {stale[-1]}")
    if arguments.check and stale:
        sys.exit(f"stale: {', '.join(stale)}; run: python {HERE.name}/regenerate.py")


if __name__ == "__main__":
    main()
