#!/bin/bash
# The coordinator, for a machine that stays: a login node, or one beside the cluster.
# It may be stopped and started again whenever you like; workers wait for it.
export ROLLOUT_TOKEN_FILE={{token_file}}

exec {{coordinator}} serve --data {{data}} --listen 0.0.0.0:{{coordinator_port}} {{guard}}
