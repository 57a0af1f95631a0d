#!/bin/bash
# Runs the coordinator on a permanent machine: a login node, or a machine beside the
# cluster. The coordinator can be stopped and started again at any time; workers wait for it.
export ROLLOUT_TOKEN_FILE={{token_file}}

exec {{coordinator}} serve --data {{data}} --listen 0.0.0.0:{{coordinator_port}} {{guard}}
