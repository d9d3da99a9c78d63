#!/usr/bin/env bash
# tools/lerobot.sh [PYTEST ARGUMENT…]: the camera plugin for LeRobot and the LeRobot exports, with the
# package `lerobot`. Needs GRIPCAST_BIN, the program; takes two minutes.
#
# The Python is GRIPCAST_LEROBOT_PYTHON, else an environment below ${GRIPCAST_CACHE:-~/.cache/gripcast}
# that it makes with a Python of at least 3.12. Where that fails, it prints SKIPPED with the reason.
set -euo pipefail
cd "$(dirname "$0")/.."
: "${GRIPCAST_BIN:?must name the program}"
GRIPCAST_BIN=$(realpath "$GRIPCAST_BIN")
export GRIPCAST_BIN HF_HUB_OFFLINE=1
plugin=python/lerobot_camera_gripcast
list=$plugin/tests/requirements.txt

skip() {
    echo "SKIPPED: LeRobot: $1" >&2
    exit 0
}

python=${GRIPCAST_LEROBOT_PYTHON:-}
if [ -z "$python" ]; then
    home=${GRIPCAST_CACHE:-$HOME/.cache/gripcast}/lerobot-$(sha256sum "$list" | cut -c1-12)
    python=$home/bin/python
    if [ ! -e "$home/complete" ]; then
        base=
        for name in python3.12 python3.13 python3; do
            if "$name" -c 'import sys; sys.exit(sys.version_info < (3, 12))' 2>/dev/null; then
                base=$name
                break
            fi
        done
        [ -n "$base" ] || skip "no Python of at least 3.12"
        rm -rf "$home"
        "$base" -m venv "$home" || skip "no environment could be made with $base"
        "$python" -m pip install --quiet --disable-pip-version-check -r "$list" ||
            skip "the packages of $list could not be installed"
        "$python" -m pip install --quiet --disable-pip-version-check --no-deps -e "$plugin"
        touch "$home/complete"
    fi
fi

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
(cd "$plugin/tests" && PYTHONPATH=. "$python" -m pytest -q -p no:cacheprovider "$@")
export GRIPCAST__GUARDS__MAX_FRAME_AGE_MS=60000 GRIPCAST__GUARDS__MAX_SKEW_MS=60000
"$GRIPCAST_BIN" -q collect --rig virtual-markers --script tests/data/three-grasps.txt \
    --dataset "$folder/collected" >/dev/null
"$GRIPCAST_BIN" -q dataset export "$folder/collected" --to lerobot --out "$folder/lerobot" >/dev/null
"$python" tests/peers/load_exports.py "$folder/collected" --lerobot "$folder/lerobot"
"$GRIPCAST_BIN" -q collect --rig virtual-markers --script tests/data/sequences.txt --black-box \
    --dataset "$folder/logged" >/dev/null
"$GRIPCAST_BIN" -q dataset export "$folder/logged" --to lerobot --sequences --out "$folder/sequences" >/dev/null
"$python" tests/peers/load_sequences.py "$folder/logged" "$folder/sequences"
