#!/usr/bin/env python3
"""Writes `para.txt`: the 4,092 paraphrases of LIBERO-Para as numbers, without their sentences.

    para.py LIBERO-PARA > para.txt

The argument is a checkout of LIBERO-Para at git dec2d93. The first line is the digest of the BDDL
files and the metadata: the SHA-256 of the lines of `sha256sum`, sorted by path. Every further line
holds the paraphrases of a task and type: index of the task in the alphabetical order of
libero_goal's files, the columns `high`, `mid` and `low`, then `NUMBER:KEYWORD:STRUCTURE` for each
paraphrase, with the two similarities of the metadata."""

import collections
import csv
import hashlib
import pathlib
import sys

METADATA = "metrics/libero_para_metadata.csv"


def main() -> None:
    checkout = pathlib.Path(sys.argv[1])
    paths = [path.relative_to(checkout) for path in checkout.glob("libero/libero/bddl_files/libero_para/*.bddl")]
    names = sorted(map(str, paths)) + [METADATA]
    digests = (hashlib.sha256((checkout / name).read_bytes()).hexdigest() for name in names)
    lines = (f"{digest}  {name}\n" for digest, name in zip(digests, names, strict=True))
    print(hashlib.sha256("".join(lines).encode()).hexdigest())
    runs = collections.defaultdict(list)
    with (checkout / METADATA).open() as file:
        for row in csv.DictReader(file):
            kind = (row["high"], row["mid"], row["low"])
            name = f"{'_'.join(kind)}_eval{row['eval']}_ver{row['batch_idx']}.bddl"
            assert f"libero/libero/bddl_files/libero_para/{name}" in names, name
            numbers = (float(row["keyword_similarity"]), float(row["structural_similarity"]))
            item = ":".join([row["batch_idx"], *(repr(number).removesuffix(".0") for number in numbers)])
            runs[int(row["eval"]), kind].append((int(row["batch_idx"]), item))
    assert sum(map(len, runs.values())) == len(names) - 1
    for (task, kind), items in sorted(runs.items()):
        print(task, *kind, *(item for _, item in sorted(items)))


main()
