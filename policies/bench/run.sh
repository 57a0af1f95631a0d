#!/usr/bin/env bash
# Times the gateway and a GPU policy of SmolVLA's size behind it:
#
#   cargo build --release -p policy-gateway --bin policy-gateway --example bench_gateway
#   BIN=target/release bash policies/bench/run.sh OUT_DIR [--size tiny] [--secs N]
#
# Needs python3 with torch, numpy, grpcio and protobuf, and no network. Writes
# OUT_DIR/gateway.json (simulated server, no GPU) and OUT_DIR/gpu.json.
set -euo pipefail

out=$1
shift
here=$(cd "$(dirname "$0")" && pwd)
bin=$(cd "${BIN:?set BIN to the folder of policy-gateway and bench_gateway}" && pwd)
mkdir -p "$out"

bench=$bin/examples/bench_gateway
[ -x "$bench" ] || bench=$bin/bench_gateway
"$bench" > "$out/gateway.json"
cat "$out/gateway.json"

export PYTHONPATH="$here/../src${PYTHONPATH:+:$PYTHONPATH}" PYTHONUNBUFFERED=1
"${PYTHON:-python3}" "$here/measure.py" --bin "$bin" --output "$out/gpu.json" "$@"
