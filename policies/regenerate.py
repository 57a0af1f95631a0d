"""Generates src/rollout_policies/proto from the repository's policy.proto.

The generated files are kept under version control, so that installing the
package needs no protocol compiler; `python regenerate.py --check` fails when
they are not what the .proto file says.

The generator is pinned to grpcio-tools 1.62.3, the last series whose output
runs with every protobuf from 3.20 on and demands no particular grpcio: this
package lives in environments that other people's policies dictate.
"""

import argparse
import pathlib
import sys
import tempfile
from importlib.metadata import PackageNotFoundError, version

GENERATOR = "1.62.3"
HERE = pathlib.Path(__file__).resolve().parent
SOURCE = HERE.parent / "proto" / "rollout" / "policy" / "v1"
TARGET = HERE / "src" / "rollout_policies" / "proto"
FILES = ("policy_pb2.py", "policy_pb2_grpc.py")


def generate(folder: pathlib.Path) -> None:
    """Writes the package `rollout_policies.proto` below `folder`."""
    from grpc_tools import protoc

    # The virtual path makes the generated imports name this package.
    status = protoc.main(
        [
            "protoc",
            f"-Irollout_policies/proto={SOURCE}",
            f"--python_out={folder}",
            f"--grpc_python_out={folder}",
            "rollout_policies/proto/policy.proto",
        ]
    )
    if status != 0:
        sys.exit(f"failed to generate from {SOURCE / 'policy.proto'}: protoc exited with {status}")


def stale(folder: pathlib.Path) -> list[str]:
    """Names of the kept files that differ from those below `folder`."""
    generated = folder / "rollout_policies" / "proto"
    return [
        name
        for name in FILES
        if not (TARGET / name).exists()
        or (TARGET / name).read_bytes() != (generated / name).read_bytes()
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
        generate(folder)
        names = stale(folder)
        if arguments.check:
            if names:
                sys.exit(f"stale: {', '.join(names)}; run: python {HERE.name}/regenerate.py")
            return
        for name in names:
            data = (folder / "rollout_policies" / "proto" / name).read_bytes()
            (TARGET / name).write_bytes(data)
            print(f"wrote {TARGET / name}")


if __name__ == "__main__":
    main()
