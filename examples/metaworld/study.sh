#!/bin/sh
# Runs a campaign of Meta-World's experts; prints its report and duration.
#
#     PYTHON=metaworld/bin/python SLOTS=16 study.sh DATA [OPTIONS OF rows.py]
#
# PYTHON has Meta-World, rollout_env and rollout_policies; the programs are on PATH. DATA, which
# must not exist, gets the database, rows, results and logs. Ports from 7521 on must be free.
set -eu
folder=$(dirname "$0") python=${PYTHON:-python3} slots=${SLOTS:-2} data=$1
shift
mkdir "$data"
export COORDINATOR_URL=http://127.0.0.1:7521 MUJOCO_GL=disable # nothing is drawn

# Waits for a line of a program's log; ends if the program does.
wait_for() {
    until grep -q "$2" "$data/$1.log"; do
        kill -0 "$3" 2>/dev/null || { cat "$data/$1.log" >&2; exit 1; }
        sleep 0.2
    done
}

"$python" "$folder/rows.py" "$@" >"$data/rows.jsonl"
started='' servers=''
trap 'kill $started 2>/dev/null; wait' EXIT
# Python answers one query at a time, in a fifth of a step's time: a server for four slots.
for number in $(seq $(((slots + 3) / 4))); do
    address=127.0.0.1:$((7530 + number))
    "$python" "$folder/experts.py" --listen $address >"$data/experts$number.log" 2>&1 &
    started="$started $!" servers="$servers,grpc://$address"
    wait_for "experts$number" "listening on" $!
done
tasks=$("$python" -c 'from metaworld.policies import *; print(*ENV_POLICY_MAP, sep=",")')
ROLLOUT_SIMULATOR="metaworld=$python -m rollout_env serve gym:Meta-World/MT1 \
    --tasks env_name=$tasks --action x,y,z,gripper --state all=observation" \
    coordinator up --data "$data" --policy "experts=${servers#,}" --assets primitives \
    --slots "$slots" --listen 127.0.0.1:7521 --gateway-listen 127.0.0.1:7522 \
    >"$data/programs.log" 2>&1 &
started="$started $!"
wait_for programs "registered with" $!

began=$(date +%s)
coordinator campaign create --name experts --policy experts --endpoint http://127.0.0.1:7522 \
    --rows "$data/rows.jsonl"
coordinator campaign status --watch experts
coordinator report experts
coordinator export experts --format jsonl >"$data/results.jsonl"
echo "$(wc -l <"$data/rows.jsonl") rollouts in $slots slots took $(($(date +%s) - began)) s"
