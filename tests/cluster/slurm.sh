#!/bin/bash
# Runs examples/cluster on a Slurm cluster of this machine alone and compares the dataset with that
# of a single process. On the way one task gets SIGTERM and asks for its turn again, one is killed,
# and the controller is killed and restarted.
#
#   tests/cluster/slurm.sh GRIPCAST
#
# Needs slurmctld, slurmd, munged (Debian: slurm-wlm, munge) and root, as slurmd does; another user
# becomes root through sudo where that asks for no password. Everything is in a temporary folder, on ports and sockets of its own; another Slurm on the machine is not
# touched. Exit codes: 0 the same bytes · 1 not · 77 Slurm is not there.
set -euo pipefail

gripcast=$(realpath "$1")
examples=$(cd "$(dirname "$0")/../../examples/cluster" && pwd)
shards=3
# A run takes one to three minutes; this is for machines that are slow or busy.
limit_s=900
export PATH=$PATH:/usr/sbin:/sbin
for tool in slurmctld slurmd munged sbatch scontrol squeue scancel; do
    if ! command -v "$tool" >/dev/null; then
        echo "$tool is not installed (Debian: apt-get install slurm-wlm munge)" >&2
        exit 77
    fi
done
if [ "$(id -u)" -ne 0 ]; then
    if ! sudo -n true 2>/dev/null; then
        echo "slurmd needs root, and sudo is missing or asks for a password (sudo -v first)" >&2
        exit 77
    fi
    exec sudo -n -- "${BASH_SOURCE[0]}" "$gripcast"
fi
# Set where the test itself is a task of some cluster.
unset "${!SLURM@}" "${!SBATCH_@}" "${!SQUEUE_@}" "${!SCANCEL_@}"

# In /tmp, as the paths of sockets have to be short.
dir=$(mktemp -d /tmp/gripcast-slurm.XXXXXX)
chmod 755 "$dir"
mkdir "$dir"/{run,log,state,spool,key,jobs}

# Daemons, steps and tasks: whoever has a file of the folder open.
ours() {
    find /proc/[0-9]*/fd -lname "$dir/*" 2>/dev/null | cut -d/ -f3 | sort -u || true
}
stop() {
    trap '' INT TERM HUP
    for _ in $(seq 50); do
        mapfile -t pids < <(ours)
        [ ${#pids[@]} -gt 0 ] || break
        kill -9 "${pids[@]}" 2>/dev/null || true
        sleep 0.2
    done
    rm -rf "$dir"
}
trap stop EXIT
trap 'exit 130' INT
trap 'exit 143' TERM HUP

started=$(date +%s)
say() { echo "$(($(date +%s) - started)) s: $*"; }
left_s() { echo $((started + limit_s - $(date +%s))); }
fail() {
    {
        say "FAILED: $*"
        timeout 10 squeue --all 2>&1 || true
        timeout 10 sinfo --Node --long 2>&1 || true
        tail -n 25 "$dir"/log/*.log "$dir"/jobs/* 2>&1 || true
    } >&2
    exit 1
}
# A command that may not take more time than there is.
limited() {
    local left
    left=$(left_s)
    [ "$left" -gt 0 ] || fail "$limit_s s are over before: $*"
    timeout --foreground --kill-after=5 "$left" "$@" || {
        local code=$?
        if [ "$code" -eq 124 ] || [ "$code" -eq 137 ]; then
            fail "$limit_s s are over in: $*"
        fi
        return "$code"
    }
}
# Slurm commands wait long for a controller that does not answer.
ask() { timeout --foreground --kill-after=5 20 "$@" 2>/dev/null; }
until_true() {
    local what=$1
    shift
    until "$@"; do
        [ "$(left_s)" -gt 0 ] || fail "$limit_s s are over, and this did not come: $what"
        sleep 0.1
    done
}

# Below the ports that the system gives to connections.
port=$((20000 + (RANDOM * 32768 + RANDOM) % 12000))
in_use=$(cat /proc/net/tcp /proc/net/tcp6 2>/dev/null || true)
while grep -qi -e "$(printf ':%04x ' "$port")" -e "$(printf ':%04x ' $((port + 1)))" <<<"$in_use"; do
    port=$((port + 2))
done
# config_overrides: two tasks at a time, however small the machine is. cred_expire: seconds until a
# requeued task may start again.
cat >"$dir/slurm.conf" <<CONF
ClusterName=gripcast
SlurmctldHost=localhost(127.0.0.1)
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
CredType=cred/munge
AuthInfo=socket=$dir/run/munge.socket,cred_expire=20
SlurmctldPort=$port
SlurmdPort=$((port + 1))
StateSaveLocation=$dir/state
SlurmdSpoolDir=$dir/spool
SlurmctldPidFile=$dir/run/slurmctld.pid
SlurmdPidFile=$dir/run/slurmd.pid
SlurmctldLogFile=$dir/log/slurmctld.log
SlurmdLogFile=$dir/log/slurmd.log
SlurmdParameters=config_overrides
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
NodeName=localhost NodeAddr=127.0.0.1 CPUs=4 RealMemory=16000 State=UNKNOWN
PartitionName=main Nodes=localhost Default=YES MaxTime=INFINITE State=UP
CONF
# Newer ones look for control groups although nothing here needs them; older ones do not know this.
version=$(slurmctld -V)
version=${version##* }
if [ "${version%%.*}" -ge 23 ]; then
    echo CgroupPlugin=disabled >"$dir/cgroup.conf"
fi
export SLURM_CONF=$dir/slurm.conf
dd if=/dev/urandom of="$dir/key/key" bs=128 count=1 status=none
chmod 400 "$dir/key/key"

# In the foreground of a child: its id is known at once, whatever it writes where.
daemon() {
    "$@" </dev/null >/dev/null 2>&1 &
    daemon_pid=$!
    disown "$daemon_pid"
}
start_controller() {
    daemon slurmctld -D -f "$SLURM_CONF"
    controller_pid=$daemon_pid
}
answers() {
    # It ends where its port is not free yet.
    kill -0 "$controller_pid" 2>/dev/null || start_controller
    grep -q 'is UP' <<<"$(ask scontrol ping)"
}
daemon munged --foreground --force --key-file="$dir/key/key" --socket="$dir/run/munge.socket" \
    --pid-file="$dir/run/munged.pid" --log-file="$dir/log/munged.log" --seed-file="$dir/run/seed"
until_true "the socket of munged" test -S "$dir/run/munge.socket"
start_controller
until_true "an answer of the controller" answers
daemon slurmd -D -f "$SLURM_CONF" -N localhost
node_state() { ask sinfo --noheader --format=%T; }
idle() { [ "$(node_state)" = idle ]; }
until_true "an idle node" idle
say "the cluster is up"

plan_flags=(--preset tiny --objects 4 --grasps 1 --spp 1)
limited "$gripcast" --quiet synth plan "${plan_flags[@]}" --out "$dir/plan"
limited "$gripcast" --quiet synth plan "${plan_flags[@]}" --out "$dir/alone"
cmp "$dir/plan/plan.jsonl" "$dir/alone/plan.jsonl"
limited "$gripcast" --quiet synth run --plan "$dir/alone"
limited "$gripcast" --quiet synth merge --plan "$dir/alone" --out "$dir/expected" --balance none
say "a single process has made the dataset"

cd "$dir/jobs"
export GRIPCAST=$gripcast MERGE_FLAGS="--balance none"
submitted=$(limited "$examples/slurm-submit.sh" "$dir/plan" "$dir/dataset" "$shards")
[[ $submitted =~ ^array\ ([0-9]+),\ merge\ ([0-9]+)$ ]] || fail "slurm-submit.sh: $submitted"
array=${BASH_REMATCH[1]}
merge=${BASH_REMATCH[2]}
cd /

# Sets `pid` to the process that simulates a shard.
task() {
    local proc
    for proc in /proc/[0-9]*; do
        if [ "$proc/exe" -ef "$gripcast" ] &&
            grep -qzxF "PLAN=$dir/plan" "$proc/environ" 2>/dev/null &&
            grep -qzxF "SLURM_ARRAY_TASK_ID=$1" "$proc/environ" 2>/dev/null; then
            pid=${proc#/proc/}
            return 0
        fi
    done
    return 1
}
# A task that stands still is surely in the middle, however fast or slow the machine is.
freeze() {
    kill -STOP "$1" || fail "a task was done before it could be stopped"
    until_true "a task that stands still" has_state "$1" T
}
has_state() { grep -q "^State:[[:space:]]*$2" "/proc/$1/status"; }
has_result() { [ -n "$(find "$dir/plan/results" -name '*.json' -print -quit 2>/dev/null)" ]; }
shows() { grep -q "$2" <<<"$(ask scontrol show job "$1")"; }
# Bit 15 of the signals that wait for the process.
has_sigterm() {
    local pending
    pending=$(awk '/^ShdPnd:/ {print $2}' "/proc/$1/status")
    (((16#$pending >> 14) & 1))
}

until_true "task 0" task 0
first=$pid
until_true "task 1" task 1
second=$pid
until_true "a result" has_result
freeze "$first"
freeze "$second"
shows "$merge" "Reason=Dependency" || fail "the merge job does not wait"

ask scancel --signal=TERM --batch "${array}_0" || fail "scancel"
until_true "SIGTERM in task 0" has_sigterm "$first"
kill -CONT "$first"
until_true "task 0 in the queue again" shows "${array}_0" "Restarts=1"
grep -q "finished work is kept" "$dir/jobs/slurm-${array}_0.out" ||
    fail "task 0 did not say that it was stopped"
say "task 0 got SIGTERM and is in the queue again"

kill -9 "$second"
until_true "the end of task 1" shows "${array}_1" "ExitCode=137:0"
say "task 1 was killed"

until_true "task 2" task 2
third=$pid
freeze "$third"
# The controller writes its state down seconds later. What it then does not know to be done it
# looks for only half an hour later.
noted="gripcast notes"
ask scontrol update "jobid=$merge" "comment=$noted" || fail "scontrol update"
until_true "the state of the controller on the disk" grep -qsa "$noted" "$dir/state/job_state"
kill -9 "$controller_pid"
until_true "the end of the controller" eval "! kill -0 $controller_pid 2>/dev/null"
start_controller
until_true "an answer of the restarted controller" answers
say "the controller was killed and answers again"
# The controller may have ended it already.
kill -CONT "$third" 2>/dev/null || true

# A controller that has lost its latest notes drains a node with tasks it does not expect; it is
# told to go on, as an administrator would.
all_done() {
    answers || return 1
    case $(node_state) in
        *drain* | *down*) ask scontrol update nodename=localhost state=resume || true ;;
    esac
    local jobs
    jobs=$(ask squeue --noheader --all) && [ -z "$jobs" ]
}
until_true "an empty queue" all_done
say "all jobs are done"
[ -d "$dir/dataset" ] || fail "there is no dataset"
diff --recursive "$dir/expected" "$dir/dataset" || fail "the datasets differ"
say "the dataset of $shards shards is that of a single process"
