#!/bin/sh
# Fills the corpora: with the seed inputs of `untrusted-input`, with the sources that
# `cargo xtask setup` unpacked, and with the built-in pack. Nothing of LIBERO's is
# kept in this repository.
set -eu
cd "$(dirname "$0")/.."
sources=${ROLLOUT_SOURCES:-${XDG_CACHE_HOME:-$HOME/.cache}/rollout/sources}
cargo run --quiet --package untrusted-input --example seeds fuzz/corpus

cp "$sources"/libero/bddl_files/*/*.bddl fuzz/corpus/bddl/
find assets/primitives -name '*.xml' ! -path '*/scenes/*' -exec cp {} fuzz/corpus/mjcf/ \;
for states in "$sources"/libero/init_files/libero_goal/*.pruned_init; do
    cp "$states" fuzz/corpus/pruned_init/
    # The pickle alone, which the target reads past the zip.
    python3 -c 'import sys, zipfile
sys.stdout.buffer.write(zipfile.ZipFile(sys.argv[1]).read("archive/data.pkl"))' \
        "$states" >"fuzz/corpus/pruned_init/$(basename "$states").pkl"
done
