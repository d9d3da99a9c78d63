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
code=0
cargo test --workspace "$@" || code=$?
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
