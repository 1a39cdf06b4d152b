#!/bin/bash
# sbatch slurm.sh STUDY OUT: a sweep on four nodes. OUT must lie on a file system that all nodes see.
#SBATCH --job-name=dssc-jax
#SBATCH --nodes=4
#SBATCH --ntasks-per-node=1
#SBATCH --exclusive
#SBATCH --time=04:00:00
# With GPUs: --ntasks-per-node=4 --gpus-per-task=1
#SBATCH --requeue
set -euo pipefail
study=$1 out=$2
file=$out.scheduler.json
rm -f "$file"
dask scheduler --scheduler-file "$file" --no-dashboard &
scheduler=$!
trap 'kill $scheduler' EXIT
until [ -s "$file" ]; do sleep 1; done
srun --overlap dask worker --scheduler-file "$file" --nthreads 1 --memory-limit 0 --no-dashboard &
address=$(python -c "import json, sys; print(json.load(open(sys.argv[1]))['address'])" "$file")
dssc-jax sweep "$study" --out "$out" --resume --cluster "$address" --json
