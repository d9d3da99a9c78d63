#!/bin/bash
# Simulates a plan on a Slurm cluster and merges it:
#
#   gripcast synth plan --preset full --out /shared/plan
#   examples/cluster/slurm-submit.sh /shared/plan /shared/dataset 500
#
# Both folders must be on a file system that all nodes see. The plan's folder holds its meshes and
# images, so it can be made elsewhere and copied as a whole. GRIPCAST names the program if it is
# not on the PATH of the nodes. Shards are 0 to N-1; most clusters allow arrays of up to 1000 tasks.
set -euo pipefail
if [ "$#" -ne 3 ]; then
    echo "usage: $0 PLAN DATASET SHARDS" >&2
    exit 2
fi
here=$(cd "$(dirname "$0")" && pwd)
export PLAN=$1 DATASET=$2 SHARDS=$3
array=$(sbatch --parsable --array="0-$((SHARDS - 1))" --export=ALL "$here/synth-task.sbatch")
merge=$(sbatch --parsable --dependency="afterany:$array" --export=ALL "$here/synth-merge.sbatch")
echo "array $array, merge $merge"
