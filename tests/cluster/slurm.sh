#!/bin/bash
# Runs examples/cluster on a Slurm cluster of this machine alone, kills a task and the controller,
# and compares the dataset with that of a single process.
#
#   tests/cluster/slurm.sh GRIPCAST [SHARDS]
#
# Needs slurmctld, slurmd and munged (Debian: slurm-wlm, munge) and root, as slurmd does. Everything
# is in a temporary folder, on ports of its own, without systemd. Exit codes: 0 the same bytes ·
# 1 not · 77 Slurm is not there.
set -euo pipefail

gripcast=$(realpath "$1")
shards=${2:-3}
here=$(cd "$(dirname "$0")" && pwd)
for tool in slurmctld slurmd munged sbatch scontrol squeue; do
    if ! command -v "$tool" >/dev/null && ! [ -x "/usr/sbin/$tool" ]; then
        echo "$tool is not installed (Debian: apt-get install slurm-wlm munge)" >&2
        exit 77
    fi
done
if [ "$(id -u)" -ne 0 ]; then
    echo "slurmd needs root" >&2
    exit 77
fi
export PATH=$PATH:/usr/sbin

dir=$(mktemp -d)
mkdir "$dir"/{run,log,state,spool,key}
chmod 755 "$dir"
stop() {
    for name in slurmd slurmctld munged; do
        if [ -s "$dir/run/$name.pid" ]; then
            kill -9 "$(cat "$dir/run/$name.pid")" 2>/dev/null || true
        fi
    done
    rm -rf "$dir"
}
trap stop EXIT

# Ports that nobody listens on; the kernel would tell, but Slurm wants to know before.
port=$((20000 + $$ % 20000))
memory_mb=$(awk '/MemTotal/ {print int($2 / 1024 * 0.9)}' /proc/meminfo)
cat >"$dir/slurm.conf" <<CONF
ClusterName=gripcast
SlurmctldHost=localhost(127.0.0.1)
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
CredType=cred/munge
AuthInfo=socket=$dir/run/munge.socket
SlurmctldPort=$port
SlurmdPort=$((port + 1))
StateSaveLocation=$dir/state
SlurmdSpoolDir=$dir/spool
SlurmctldPidFile=$dir/run/slurmctld.pid
SlurmdPidFile=$dir/run/slurmd.pid
SlurmctldLogFile=$dir/log/slurmctld.log
SlurmdLogFile=$dir/log/slurmd.log
ProctrackType=proctrack/pgid
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
SchedulerType=sched/backfill
SchedulerParameters=sched_min_interval=0,batch_sched_delay=1,sched_interval=1,bf_interval=2
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
ReturnToService=2
NodeName=localhost NodeAddr=127.0.0.1 CPUs=$(nproc) RealMemory=$memory_mb State=UNKNOWN
PartitionName=main Nodes=localhost Default=YES MaxTime=INFINITE State=UP
CONF
export SLURM_CONF=$dir/slurm.conf
dd if=/dev/urandom of="$dir/key/key" bs=128 count=1 status=none
chmod 400 "$dir/key/key"
munged --force --key-file="$dir/key/key" --socket="$dir/run/munge.socket" \
    --pid-file="$dir/run/munged.pid" --log-file="$dir/log/munged.log" --seed-file="$dir/run/seed"
slurmctld -f "$SLURM_CONF"
slurmd -f "$SLURM_CONF" -N localhost

# Until a command succeeds; asks up to 3000 times.
until_true() {
    for _ in $(seq 3000); do
        if "$@" >/dev/null 2>&1; then
            return 0
        fi
        sleep 0.2
    done
    echo "never came: $*" >&2
    tail -n 20 "$dir"/log/*.log >&2
    return 1
}
idle() { scontrol show node localhost | grep -q 'State=IDLE\|State=MIXED\|State=ALLOCATED'; }
running() { pgrep -f "synth run --plan $dir/plan --shard" >/dev/null; }
has_result() { [ -n "$(find "$dir/plan/results" -name '*.json' -print -quit)" ]; }
empty() { [ -z "$(squeue --noheader)" ]; }

plan_flags=(--preset tiny --objects 3 --grasps 1 --samples 1)
"$gripcast" synth plan "${plan_flags[@]}" --out "$dir/plan"
"$gripcast" synth plan "${plan_flags[@]}" --out "$dir/alone"
cmp "$dir/plan/plan.jsonl" "$dir/alone/plan.jsonl"
"$gripcast" synth run --plan "$dir/alone"
"$gripcast" synth merge --plan "$dir/alone" --out "$dir/expected" --unbalanced

until_true idle
cd "$dir"
export GRIPCAST=$gripcast MERGE_FLAGS=--unbalanced
"$here/../../examples/cluster/slurm-submit.sh" "$dir/plan" "$dir/dataset" "$shards"

until_true running
until_true has_result
pkill -9 -f -n "synth run --plan $dir/plan --shard"
echo "killed a task"
kill -9 "$(cat "$dir/run/slurmctld.pid")"
echo "killed the controller"
slurmctld -f "$SLURM_CONF"
until_true scontrol ping
# A controller that was killed takes the node for one that was lost.
scontrol update nodename=localhost state=resume 2>/dev/null || true
until_true empty

diff --recursive --brief "$dir/expected" "$dir/dataset"
echo "the dataset of $shards shards is that of a single process"
