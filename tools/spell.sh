#!/usr/bin/env bash
# tools/spell.sh: checks the spelling of texts and source code with codespell. Words that it takes
# for mistakes and that are right here stand in tools/spelling.txt, in lower case.
#
# codespell is installed into ${GRIPCAST_CACHE:-~/.cache/gripcast} the first time. Where that is not
# possible, spelling is not checked, which is printed here and in the summary of `make test`;
# GRIPCAST_REQUIRE_SPELLING=1 makes that an error.
set -euo pipefail
cd "$(dirname "$0")/.."

version=2.4.3
home=${GRIPCAST_CACHE:-$HOME/.cache/gripcast}/codespell-$version
codespell=$home/bin/codespell
mkdir -p target/skipped
record=target/skipped/spelling
rm -f "$record"

if ! [ -x "$codespell" ]; then
    echo "spell: installing codespell $version into $home" >&2
    rm -rf "$home"
    if ! { python3 -m venv "$home" &&
        "$home/bin/python" -m pip install --quiet --disable-pip-version-check \
            --retries 1 --timeout 15 "codespell==$version"; } >&2; then
        rm -rf "$home"
        reason="codespell $version cannot be installed (network, or the package python3-venv)"
        echo "SKIPPED: spelling: $reason" >&2
        [ -z "${GRIPCAST_REQUIRE_SPELLING:-}" ] || exit 1
        printf 'spelling\ttools/spell.sh\t%s\n' "$reason" >"$record"
        exit 0
    fi
fi

# Snapshots repeat texts of the sources; fuzz/corpus and tests/data have damaged inputs.
git ls-files -z -- '*.md' '*.rs' '*.py' '*.sh' '*.toml' '*.html' '*.css' '*.js' '*.service' Makefile \
    ':!fuzz/corpus' ':!tests/data' ':!tests/it/snapshots' |
    xargs -0 "$codespell" --ignore-words tools/spelling.txt
