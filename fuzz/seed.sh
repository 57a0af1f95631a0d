#!/bin/sh
# Fills the corpora: with the seed inputs of the tests, with LIBERO's files that
# `cargo xtask setup` unpacked (this repository contains none of them), and with the
# models of the built-in pack.
set -eu
cd "$(dirname "$0")/.."
sources=${ROLLOUT_SOURCES:-${XDG_CACHE_HOME:-$HOME/.cache}/rollout/sources}
cargo run --quiet --package tests --example seeds fuzz/corpus

cp "$sources"/libero/bddl_files/*/*.bddl fuzz/corpus/bddl/
find assets/primitives -name '*.xml' ! -path '*/scenes/*' -exec cp {} fuzz/corpus/mjcf/ \;
for states in "$sources"/libero/init_files/libero_goal/*.pruned_init; do
    cp "$states" fuzz/corpus/pruned_init/
    # The pickle without its zip archive: the target also parses an input as a bare pickle.
    python3 -c 'import sys, zipfile
sys.stdout.buffer.write(zipfile.ZipFile(sys.argv[1]).read("archive/data.pkl"))' \
        "$states" >"fuzz/corpus/pruned_init/$(basename "$states").pkl"
done
