#!/usr/bin/env bash
# tools/run-tests.sh [ARGUMENT…]: `cargo test --workspace` with these arguments, then a summary of what was
# skipped and why. Exit status: that of `cargo test`.
set -euo pipefail
cd "$(dirname "$0")/.."
# shellcheck disable=SC1091
. tools/env.sh
mkdir -p target/skipped
: >target/skipped/tests
export GRIPCAST_SKIPS=$PWD/target/skipped/tests
if [ -z "${GRIPCAST_PYTHON:-}" ] && python=$(tools/peers.sh path); then
    export GRIPCAST_PYTHON=$python
fi
code=0
cargo test --workspace "$@" || code=$?
tools/skipped.sh
exit "$code"
