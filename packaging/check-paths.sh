#!/usr/bin/env bash
# packaging/check-paths.sh BINARY: fails where the binary names a folder of this machine: the
# checkout, the home folder, cargo's or rustup's. packaging/build-flags.sh keeps them out.
set -euo pipefail
[ $# -eq 1 ] && [ -f "$1" ] || {
    echo "usage: packaging/check-paths.sh BINARY" >&2
    exit 2
}
home=${HOME:-}
checkout=$(cd "$(dirname "$0")/.." && pwd)
folders=("$checkout" "${CARGO_HOME:-$home/.cargo}" "${RUSTUP_HOME:-$home/.rustup}" "$home"
    "${CARGO_TARGET_DIR:-}")

failed=0
for folder in "${folders[@]}"; do
    # Not "/", which every path starts with.
    case $folder in '' | /) continue ;; esac
    found=$(strings -a "$1" | grep -F -m 3 -e "$folder/" || true)
    if [ -n "$found" ]; then
        {
            echo "check-paths: $1 names $folder; expected no folder of this machine:"
            cut -c1-200 <<<"$found"
        } >&2
        failed=1
    fi
done
[ "$failed" -eq 0 ] || {
    echo "check-paths: build it with packaging/build-flags.sh (make deb, make tarball)" >&2
    exit 1
}
