#!/usr/bin/env bash
# tools/run-tests.sh [ARGUMENT…]: `cargo test --workspace` with these arguments, without any also the tests
# of the Python package, then a summary of what was skipped and why. Exit status: that of the first that
# failed.
set -euo pipefail
cd "$(dirname "$0")/.."
# shellcheck disable=SC1091
. tools/env.sh
mkdir -p target/skipped
rm -f target/skipped/python
: >target/skipped/tests
export GRIPCAST_SKIPS=$PWD/target/skipped/tests
if [ -z "${GRIPCAST_PYTHON:-}" ] && python=$(tools/peers.sh path); then
    export GRIPCAST_PYTHON=$python
fi

# Runs a command and stops it after 15 minutes without output, which is a test that hangs; prints what
# runs then.
silence_limit_s=900
watched() {
    local log=target/test-output code=0
    : >"$log"
    set -m
    { "$@" 2>&1 | tee "$log"; } &
    set +m
    local job=$!
    # Its own group, which has to end with this script, too.
    trap 'kill -- "-$job" 2>/dev/null || true' EXIT
    (
        while sleep 15 2>/dev/null && kill -0 "$job" 2>/dev/null; do
            [ $(($(date +%s) - $(stat -c %Y "$log"))) -gt "$silence_limit_s" ] || continue
            echo "run-tests: no output for $silence_limit_s s, a test hangs; stopped. What runs:"
            for process in /proc/[0-9]*; do
                printf '%s\t%s\t%s\n' "${process#/proc/}" "$(cut -d' ' -f3,4,14 "$process/stat")" \
                    "$(tr '\0' ' ' <"$process/cmdline" | cut -c 1-300)"
            done 2>/dev/null | awk -F '\t' 'BEGIN { print "pid\tstate, parent, CPU ticks\tcommand" } $3 != ""'
            kill -- "-$job"
        done
    ) </dev/null >&2 &
    local watcher=$!
    wait "$job" || code=$?
    kill "$watcher" 2>/dev/null || true
    trap - EXIT
    return "$code"
}

code=0
if [ -t 1 ]; then
    cargo test --workspace "$@" || code=$?
else
    watched cargo test --workspace "$@" || code=$?
fi
if [ $# -eq 0 ]; then
    if tools/python.sh path >/dev/null; then
        tools/python.sh || code=$((code ? code : $?))
    else
        reason="its libraries are not installed (tools/python.sh install)"
        echo "SKIPPED: the tests of the Python package: $reason" >&2
        printf 'python\ttools/python.sh\t%s\n' "$reason" >target/skipped/python
    fi
fi
tools/skipped.sh
exit "$code"
