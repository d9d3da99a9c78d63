#!/usr/bin/env bash
# tools/wheel.sh [OUT]: the wheel of the Python package for Linux on x86-64 (manylinux_2_28, CPython
# 3.10 and newer) and its sources, in target/wheels or OUT.
#
# zig links it against the C library of 2018, so that no old system is needed to build it; maturin and
# zig come from PyPI, into ${GRIPCAST_CACHE:-~/.cache/gripcast}.
set -euo pipefail
cd "$(dirname "$0")/.."
# shellcheck disable=SC1091
. tools/env.sh

tools=(maturin==1.16.0 ziglang==0.17.1)
max_bytes=$((25 * 1024 * 1024))
home=${GRIPCAST_CACHE:-$HOME/.cache/gripcast}/wheel-$(echo "${tools[@]}" | sha256sum | cut -c1-12)
if [ ! -e "$home/complete" ]; then
    echo "wheel: installing ${tools[*]} into $home" >&2
    rm -rf "$home"
    python3 -m venv "$home"
    "$home/bin/python" -m pip install --quiet --disable-pip-version-check --only-binary :all: "${tools[@]}"
    touch "$home/complete"
fi
target=$(cargo metadata --format-version 1 --no-deps --offline |
    python3 -c 'import json, sys; print(json.load(sys.stdin)["target_directory"])')
out=${1:-$target/wheels}
# The same bytes for the same sources.
export SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct || echo 0)}
# shellcheck disable=SC1091
. packaging/build-flags.sh
export PATH=$home/bin:$PATH
rm -rf "$out"
said=$(maturin sdist --out "$out" 2>&1) || {
    echo "$said" >&2
    exit 1
}
maturin build --quiet --release --locked --zig --compatibility manylinux_2_28 --out "$out"
for wheel in "$out"/*.whl; do
    bytes=$(stat -c %s "$wheel")
    if [ "$bytes" -gt "$max_bytes" ]; then
        echo "wheel: $wheel has $bytes bytes, more than $max_bytes" >&2
        exit 1
    fi
done
ls -l "$out" >&2
