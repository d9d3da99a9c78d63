#!/usr/bin/env bash
# tools/python.sh [PYTEST ARGUMENT…]: builds the Python package, runs its tests and checks its types, in
# an environment below ${GRIPCAST_CACHE:-~/.cache/gripcast} that it makes where it is missing.
# tools/python.sh install only makes the environment, tools/python.sh path prints its interpreter or
# fails where it is missing.
#
# Everything is built with the profile of cargo's tests; the program, which the tests compare with, too.
set -euo pipefail
cd "$(dirname "$0")/.."
# shellcheck disable=SC1091
. tools/env.sh

list=python/tests/requirements.txt
# Another list or another Python is another folder.
key=$({ cat "$list" && python3 -c 'import sys; print(sys.version)'; } | sha256sum | cut -c1-12)
home=${GRIPCAST_CACHE:-$HOME/.cache/gripcast}/python-$key
python=$home/bin/python
if [ "${1:-}" = path ]; then
    [ -e "$home/complete" ] && echo "$python"
    exit
fi
if [ ! -e "$home/complete" ]; then
    echo "python: installing the packages of $list into $home" >&2
    rm -rf "$home"
    python3 -m venv "$home"
    "$python" -m pip install --quiet --disable-pip-version-check --only-binary :all: -r "$list"
    touch "$home/complete"
fi
[ "${1:-}" != install ] || exit 0

# With the features that dependencies have in `cargo test --workspace`, after which nothing is compiled
# again: those of tests, which `--examples` asks for too.
cargo build --locked --workspace --lib --bins --examples
target=$(cargo metadata --format-version 1 --no-deps --offline |
    python3 -c 'import json, sys; print(json.load(sys.stdin)["target_directory"])')
export GRIPCAST_BIN=${GRIPCAST_BIN:-$target/debug/gripcast}
# As the wheel has it; `make wheel` and packaging/try-wheel.sh test that.
package=$("$python" -c 'import sysconfig; print(sysconfig.get_path("platlib"))')/gripcast
rm -rf "$package"
mkdir "$package"
cp python/gripcast/*.py python/gripcast/*.pyi python/gripcast/py.typed "$package"
cp "$target/debug/libgripcast_native.so" "$package/_native.abi3.so"
PATH=$home/bin:$PATH "$python" -m pytest "$@"
"$python" -m mypy
"$python" -m pyright --pythonpath "$python"
"$python" -m mypy.stubtest --ignore-missing-stub gripcast
