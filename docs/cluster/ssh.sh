#!/bin/bash
# ssh.sh STUDY OUT HOST...: a sweep with a worker on every host. OUT must be the same folder on all of them, and
# `dask` and `dssc-jax` on the path of a non-interactive shell. REMOTE replaces ssh where another launcher is used.
set -euo pipefail
study=$1 out=$2
shift 2
port=${PORT:-8786}
address=tcp://${ADDRESS:-$(hostname -I | cut -d' ' -f1)}:$port
dask scheduler --port "$port" --no-dashboard &
started=$!
trap 'kill $started $(jobs -p) 2>/dev/null' EXIT
for host in "$@"; do
    ${REMOTE:-ssh} "$host" dask worker "$address" --nthreads 1 --memory-limit 0 --no-dashboard --death-timeout 60 &
done
dssc-jax sweep "$study" --out "$out" --resume --cluster "$address" --json
