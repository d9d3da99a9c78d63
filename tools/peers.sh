#!/usr/bin/env bash
# tools/peers.sh install|path: the Python with the libraries of tests/peers/requirements.txt, which the
# tests hold gripcast's files against. `install` makes it below ${GRIPCAST_CACHE:-~/.cache/gripcast}
# unless it is there; `path` prints its interpreter, or fails where it is not there.
set -euo pipefail
cd "$(dirname "$0")/.."

list=tests/peers/requirements.txt
# Other versions are another folder.
home=${GRIPCAST_CACHE:-$HOME/.cache/gripcast}/peers-$(sha256sum "$list" | cut -c1-12)
python=$home/bin/python

case "${1:-}" in
    path) [ -e "$home/complete" ] && echo "$python" ;;
    install)
        [ ! -e "$home/complete" ] || exit 0
        echo "peers: installing the Python libraries of $list into $home" >&2
        rm -rf "$home"
        python3 -m venv "$home"
        "$python" -m pip install --quiet --disable-pip-version-check --only-binary :all: -r "$list"
        touch "$home/complete"
        ;;
    *)
        echo "usage: tools/peers.sh install|path" >&2
        exit 2
        ;;
esac
