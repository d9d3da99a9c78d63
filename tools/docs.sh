#!/usr/bin/env bash
# tools/docs.sh: checks the links of all Markdown files and builds the book of docs/ into
# target/book/html.
#
# mdbook is installed into ${GRIPCAST_CACHE:-~/.cache/gripcast} the first time. Without network the
# book is not built, which is printed; GRIPCAST_REQUIRE_MDBOOK=1 makes that an error.
set -euo pipefail
cd "$(dirname "$0")/.."
# shellcheck disable=SC1091
. tools/env.sh

python3 tools/docs.py check
python3 tools/docs.py stage target/book

version=0.5.4
home=${GRIPCAST_CACHE:-$HOME/.cache/gripcast}/mdbook-$version
mdbook=$home/bin/mdbook
if ! [ -x "$mdbook" ]; then
    echo "docs: installing mdbook $version into $home" >&2
    build=$(mktemp -d)
    trap 'rm -rf "$build"' EXIT
    # Optimised for a short build: the book has forty pages.
    CARGO_TARGET_DIR=$build CARGO_PROFILE_RELEASE_LTO=off CARGO_PROFILE_RELEASE_OPT_LEVEL=0 \
        CARGO_PROFILE_RELEASE_CODEGEN_UNITS=16 CARGO_PROFILE_RELEASE_DEBUG=0 \
        cargo install --quiet --locked --no-track --no-default-features --features search \
        --root "$home" "mdbook@$version" || {
        echo "SKIPPED: docs: mdbook $version could not be installed (network?)" >&2
        [ -z "${GRIPCAST_REQUIRE_MDBOOK:-}" ]
        exit
    }
fi
"$mdbook" build target/book
echo "docs: target/book/html/index.html" >&2
