#!/usr/bin/env bash
# tools/deny.sh: checks the dependencies against deny.toml: licences, sources, duplicates, and
# known vulnerabilities where the database of advisories can be had.
#
# The database comes from GitHub. Without it, advisories are not checked, which is said here and in
# the summary of `make test`; GRIPCAST_REQUIRE_ADVISORIES=1 makes that an error.
# cargo-deny is installed into ${GRIPCAST_CACHE:-~/.cache/gripcast} the first time.
set -euo pipefail
cd "$(dirname "$0")/.."
# shellcheck disable=SC1091
. tools/env.sh

version=0.20.2
home=${GRIPCAST_CACHE:-$HOME/.cache/gripcast}/cargo-deny-$version
deny=$home/bin/cargo-deny
# Seconds that the database may take.
limit_s=60

if ! [ -x "$deny" ]; then
    echo "deny: installing cargo-deny $version into $home" >&2
    build=$(mktemp -d)
    trap 'rm -rf "$build"' EXIT
    # Built for a short build, not for speed: the check itself takes a second.
    CARGO_TARGET_DIR=$build CARGO_PROFILE_RELEASE_LTO=off CARGO_PROFILE_RELEASE_OPT_LEVEL=0 \
        CARGO_PROFILE_RELEASE_CODEGEN_UNITS=16 CARGO_PROFILE_RELEASE_DEBUG=0 \
        cargo install --quiet --locked --no-track --root "$home" "cargo-deny@$version"
fi

mkdir -p target/skipped
record=target/skipped/advisories
rm -f "$record"

"$deny" --log-level warn check --hide-inclusion-graph bans licenses sources

# Without git's questions for a password.
if fetched=$(GIT_TERMINAL_PROMPT=0 timeout "$limit_s" "$deny" fetch db 2>&1); then
    "$deny" --log-level warn check --hide-inclusion-graph --disable-fetch advisories
else
    why=$(grep -v '^[[:space:]]*$' <<<"$fetched" | tail -n 1 || true)
    reason="the database of known vulnerabilities cannot be fetched: ${why:-no answer in $limit_s s}"
    echo "SKIPPED: advisories: $reason" >&2
    [ -z "${GRIPCAST_REQUIRE_ADVISORIES:-}" ] || exit 1
    printf 'advisories\ttools/deny.sh\t%s\n' "$reason" >"$record"
fi
