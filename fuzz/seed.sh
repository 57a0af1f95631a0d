#!/bin/sh
# Fills the corpora from the sources that `cargo xtask setup` unpacked and from
# the built-in pack. Nothing of LIBERO's is kept in this repository.
set -eu
cd "$(dirname "$0")"
sources=${ROLLOUT_SOURCES:-${XDG_CACHE_HOME:-$HOME/.cache}/rollout/sources}
mkdir -p corpus/bddl corpus/mjcf corpus/pruned_init

cp "$sources"/libero/bddl_files/*/*.bddl corpus/bddl/
find ../assets/primitives -name '*.xml' ! -path '*/scenes/*' -exec cp {} corpus/mjcf/ \;
for states in "$sources"/libero/init_files/libero_goal/*.pruned_init; do
    cp "$states" corpus/pruned_init/
    # The pickle alone, which the target reads past the zip.
    python3 -c 'import sys, zipfile
sys.stdout.buffer.write(zipfile.ZipFile(sys.argv[1]).read("archive/data.pkl"))' \
        "$states" >"corpus/pruned_init/$(basename "$states").pkl"
done
