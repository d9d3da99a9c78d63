#!/usr/bin/env bash
# packaging/stage.sh BINARY FOLDER: writes what packages hold beside the binary: man pages,
# completions, licences. The same bytes for the same sources and SOURCE_DATE_EPOCH.
set -euo pipefail
[ $# -eq 2 ] || {
    echo "usage: packaging/stage.sh BINARY FOLDER" >&2
    exit 2
}
binary=$(realpath "$1")
folder=$2

rm -rf "$folder"
mkdir -p "$folder/completions"
"$binary" --quiet man --out "$folder/man"
"$binary" completions bash >"$folder/completions/gripcast.bash"
"$binary" completions zsh >"$folder/completions/_gripcast"
"$binary" completions fish >"$folder/completions/gripcast.fish"
python3 "$(dirname "$0")/third-party.py" | gzip -9n >"$folder/THIRD-PARTY.txt.gz"
