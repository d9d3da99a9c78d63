#!/usr/bin/env bash
# packaging/try-in-chroot.sh PACKAGE.deb [SUITE]: installs the package into a fresh Debian or Ubuntu
# with apt, uses it there, removes it, and looks for what is left.
#
# SUITE: bookworm, trixie, jammy or noble; the oldest Debian whose C library is new enough when none
# is named.
# Needs root, a network and mmdebstrap or debootstrap; says SKIPPED and why without one of them, and
# ends with 0 then. GRIPCAST_REQUIRE_CHROOT=1 makes that an error; GRIPCAST_MIRROR names another
# mirror. With GRIPCAST_BROWSER_PYTHON, a Python that has playwright, three grasps are collected from
# the page in Chromium too. Exit codes: 0 all held or skipped · 1 something did not hold · 2 usage.
set -euo pipefail

# Debian's suites with their C libraries, oldest first.
suites=("bookworm 2.36" "trixie 2.41")
work=/var/lib/gripcast
rig=/usr/share/doc/gripcast/examples/rigs/example-two-minis-d435.toml
script=/usr/share/doc/gripcast/examples/three-grasps.txt

say() { echo "try-in-chroot: $*" >&2; }
fail() {
    say "FAILED: $*"
    exit 1
}
skip() {
    say "SKIPPED: $*"
    [ -z "${GRIPCAST_REQUIRE_CHROOT:-}" ] || exit 1
    exit 0
}
usage() {
    echo "usage: packaging/try-in-chroot.sh PACKAGE.deb [bookworm|trixie|jammy|noble]" >&2
    exit 2
}

# The oldest Debian that the package's dependency on the C library allows.
suite_for() {
    local needed suite glibc
    needed=$(dpkg-deb -f "$1" Depends | sed -n 's/.*libc6 (>= \([0-9.]*\)).*/\1/p')
    for entry in "${suites[@]}"; do
        read -r suite glibc <<<"$entry"
        if dpkg --compare-versions "$glibc" ge "${needed:-0}"; then
            echo "$suite"
            return
        fi
    done
    return 1
}

make_debian() {
    say "making a fresh system, $suite"
    if command -v mmdebstrap >/dev/null; then
        mmdebstrap --quiet --mode=root --variant=apt --keyring="$keyring" --components="$components" \
            "$suite" "$root" "$mirror"
    else
        debootstrap --variant=minbase --keyring="$keyring" --components="$components" \
            "$suite" "$root" "$mirror" >/dev/null
    fi
    # Nothing is started in here by installing it.
    printf '#!/bin/sh\nexit 101\n' >"$root/usr/sbin/policy-rc.d"
    chmod 755 "$root/usr/sbin/policy-rc.d"
    mount -t proc proc "$root/proc"
    cp /etc/resolv.conf "$root/etc/resolv.conf"
}

inside() { "${in_root[@]}" "$@"; }
# As the user of the service.
as_service() { "${in_service[@]}" "$@"; }
# As a user without any groups of ours.
as_other() { inside setpriv --reuid nobody --regid nogroup --clear-groups -- "$@"; }

install_package() {
    cp "$package" "$root/tmp/gripcast.deb"
    inside apt-get -q update >/dev/null
    inside apt-get -q install -y --no-install-recommends /tmp/gripcast.deb udev >"$scratch/apt" 2>&1 ||
        { cat "$scratch/apt" >&2 && fail "apt could not install the package"; }
    rm "$root/tmp/gripcast.deb"
    inside dpkg -L gripcast >"$scratch/files"
    inside dpkg-query -W -f '${Conffiles}\n' gripcast | awk 'NF { print $1 }' >"$scratch/conffiles"
    say "installed with $(grep -c '^Setting up' "$scratch/apt") packages"
}

check_system_files() {
    inside getent passwd gripcast >/dev/null || fail "there is no user gripcast"
    local state
    state=$(inside systemctl is-enabled gripcast.service || true)
    [ "$state" = disabled ] || fail "the service is \`$state\`, not disabled"
    inside systemd-analyze verify --man=no gripcast.service || fail "systemd refuses the unit"
    if inside udevadm verify --help >/dev/null 2>&1; then
        inside udevadm verify /usr/lib/udev/rules.d/70-gripcast.rules >"$scratch/udev" 2>&1 ||
            { cat "$scratch/udev" >&2 && fail "udev refuses the rules"; }
    else
        say "SKIPPED: this udev cannot check rules (trixie's can)"
    fi
    inside test -e /usr/share/man/man1/gripcast-collect.1.gz || fail "there are no manual pages"
    inside bash -n /usr/share/bash-completion/completions/gripcast || fail "bash completion"
    say "user, unit, udev rules, manual pages and completions are there"
}

# The token: for root and the service's group only, long enough, and not replaced by an upgrade.
check_token() {
    local file=$root/etc/gripcast/token before
    [ "$(inside stat -c '%a %U:%G %h' /etc/gripcast/token)" = "640 root:gripcast 1" ] ||
        fail "the token is not root:gripcast with mode 640: $(ls -l "$file")"
    [ "$(base64 -d <"$file" | wc -c)" -eq 24 ] || fail "the token does not hold 192 bits"
    as_other cat /etc/gripcast/token >/dev/null 2>&1 && fail "every user can read the token"
    before=$(cat "$file")
    inside /var/lib/dpkg/info/gripcast.postinst configure 0 >"$scratch/err" 2>&1 ||
        { cat "$scratch/err" >&2 && fail "the package cannot be configured again"; }
    [ "$(cat "$file")" = "$before" ] || fail "configuring the package again replaced the token"
    [ -z "$(find "$root/etc/gripcast" -name 'token.*')" ] || fail "a temporary token is left"
    say "the token is there, closed to other users, and stays"
}

# Runs the program; its exit code has to be the first argument.
expect() {
    local wanted=$1 found=0
    shift
    "$@" >"$scratch/out" 2>"$scratch/err" || found=$?
    if [ "$found" -ne "$wanted" ]; then
        cat "$scratch/out" "$scratch/err" >&2
        fail "exit code $found instead of $wanted: $*"
    fi
}

try_program() {
    local wanted found
    wanted=$(inside dpkg-query -W -f '${Version}' gripcast)
    found=$(inside gripcast --version)
    [ "$found" = "gripcast ${wanted%-*}" ] || fail "\`$found\` is not version $wanted"

    expect 0 inside gripcast config show --config /etc/gripcast/config.toml
    expect 0 inside gripcast doctor --json
    grep -q 'no camera is plugged in' "$scratch/out" || say "note: doctor sees cameras here"
    # No camera of this rig is plugged in: that is what doctor is for.
    expect 4 inside gripcast doctor --json --rig "$rig"
    grep -q '"verdict": "fail"' "$scratch/out" || fail "doctor names no failure"
    say "version, settings and doctor are as expected"

    mkdir -p "$root$work"
    chroot "$root" chown gripcast:gripcast "$work"
    # A machine that is busy paints the virtual cameras late.
    expect 0 as_service env GRIPCAST__GUARDS__MAX_FRAME_AGE_MS=5000 \
        GRIPCAST__GUARDS__MAX_SKEW_MS=5000 \
        gripcast collect --json --rig virtual --script "$script" --dataset "$work/dataset"
    expect 0 as_service gripcast dataset verify --json "$work/dataset"
    local grasps=("$root$work"/dataset/grasps/*/grasp.json)
    [ ${#grasps[@]} -eq 3 ] || fail "${#grasps[@]} grasps instead of 3"
    say "three grasps were collected and verified"
}

# Starts the daemon as the unit does, with more arguments, and waits until its socket is there.
start_daemon() {
    # Not through a function, which would be a process in between.
    "${in_service[@]}" gripcast daemon --config /etc/gripcast/config.toml --rig virtual \
        --dataset "$work/dataset" "$@" 2>"$scratch/daemon" &
    daemon=$!
    curl -fsS --retry 30 --retry-delay 1 --retry-all-errors --unix-socket "$socket" \
        -o "$scratch/health" http://localhost/api/health 2>"$scratch/curl" ||
        { cat "$scratch/daemon" >&2 && fail "the daemon does not answer on its socket"; }
}
stop_daemon() {
    local code=0
    # chroot, env and setpriv replace themselves: the process is the daemon.
    kill -TERM "$daemon"
    wait "$daemon" || code=$?
    daemon=
    [ "$code" -eq 0 ] || [ "$code" -eq 75 ] || fail "the daemon ended with $code"
}
# The status of a request to the page's port, 000 where nobody listens.
status() { curl -sS -o /dev/null -w '%{http_code}' "$@" 2>/dev/null || true; }

# The daemon as the unit starts it, without systemd: first with the packaged settings, then with the
# page turned on.
try_daemon() {
    if ! inside gripcast daemon --help >/dev/null 2>&1; then
        say "SKIPPED: this program has no verb \`daemon\`; neither service nor page were tried"
        return
    fi
    local url=http://127.0.0.1:7471 socket=$root/run/gripcast/gripcast.sock token
    token=$(cat "$root/etc/gripcast/token")
    # As RuntimeDirectory= and RuntimeDirectoryMode= of the unit.
    inside install -d -o gripcast -g gripcast -m 0750 /run/gripcast
    [ "$(status "$url/")" = 000 ] || fail "another program listens on $url: stop it first"

    start_daemon
    [ "$(status "$url/")" = 000 ] || fail "the packaged settings open a TCP port"
    as_other test -e /run/gripcast/gripcast.sock && fail "every user can reach the socket"
    stop_daemon
    say "with the packaged settings the daemon answers on its socket alone, closed to other users"

    # The page, as config.toml and docs/how-to/install.md say.
    sed -i -e '/^listen = "none"$/d' -e 's/^#\(listen = \)/\1/' -e 's/^#\(token_file = \)/\1/' \
        "$root/etc/gripcast/config.toml"
    start_daemon
    curl -fsS "$url/" | grep -qi '<html' || fail "there is no page"
    [ "$(status "$url/api/state")" = 401 ] || fail "the page's API answers without the token"
    [ "$(status -H "Authorization: Bearer $token" "$url/api/state")" = 200 ] ||
        fail "the page's API refuses the token"
    if [ -n "${GRIPCAST_BROWSER_PYTHON:-}" ]; then
        "$GRIPCAST_BROWSER_PYTHON" "$(dirname "$0")/../tests/web/e2e.py" \
            --url "$url" --token "$token" --only grasps >"$scratch/page" 2>&1 ||
            { cat "$scratch/page" >&2 && fail "the page does not collect"; }
        say "three grasps were collected from the page in Chromium"
    else
        say "SKIPPED: no grasps from the page (GRIPCAST_BROWSER_PYTHON names a Python with" \
            "playwright, see tests/web/e2e.py)"
    fi
    stop_daemon
    expect 0 as_service gripcast dataset verify --json "$work/dataset"
    local grasps=("$root$work"/dataset/grasps/*/grasp.json)
    [ -z "${GRIPCAST_BROWSER_PYTHON:-}" ] || [ ${#grasps[@]} -eq 6 ] ||
        fail "${#grasps[@]} grasps instead of 6"
    say "with its page on, the daemon asks for the token; it ended at SIGTERM"
}

remove_package() {
    inside apt-get -q remove -y gripcast >"$scratch/apt" 2>&1 ||
        { cat "$scratch/apt" >&2 && fail "apt could not remove the package"; }
    local path left=()
    while read -r path; do
        if [ -f "$root$path" ] && ! grep -qxF "$path" "$scratch/conffiles"; then
            left+=("$path")
        fi
    done <"$scratch/files"
    [ ${#left[@]} -eq 0 ] || fail "left after removal: ${left[*]}"
    while read -r path; do
        [ -f "$root$path" ] || fail "removal took the settings $path"
    done <"$scratch/conffiles"

    inside apt-get -q purge -y gripcast >"$scratch/apt" 2>&1 ||
        { cat "$scratch/apt" >&2 && fail "apt could not purge the package"; }
    mapfile -t left < <(find "$root" -xdev -path "$root/proc" -prune -o -iname '*gripcast*' -print |
        sed "s#^$root##" | grep -Ev "^($work|/run/gripcast)(/|\$)")
    [ ${#left[@]} -eq 0 ] || fail "left after purging: ${left[*]}"
    [ -d "$root$work/dataset/grasps" ] || fail "purging took the dataset"
    say "removed: settings stayed until they were purged, the dataset is still there"
}

[ $# -ge 1 ] && [ $# -le 2 ] || usage
package=$1
[ -f "$package" ] || {
    say "there is no package $package (make deb)"
    exit 2
}
[ "$(id -u)" -eq 0 ] || skip "a chroot needs root"
command -v mmdebstrap >/dev/null || command -v debootstrap >/dev/null ||
    skip "neither mmdebstrap nor debootstrap is installed"
unshare --mount true 2>/dev/null || skip "file systems of one's own may not be mounted here"
suite=${2:-$(suite_for "$package")} || skip "its C library is newer than that of any Debian known here"
components=main
case $suite in
    bookworm | trixie)
        mirror=http://deb.debian.org/debian
        keyring=/usr/share/keyrings/debian-archive-keyring.gpg
        ;;
    jammy | noble)
        mirror=http://archive.ubuntu.com/ubuntu
        keyring=/usr/share/keyrings/ubuntu-archive-keyring.gpg
        components=main,universe
        ;;
    *) usage ;;
esac
mirror=${GRIPCAST_MIRROR:-$mirror}
[ -e "$keyring" ] || skip "$keyring is not there (debian-archive-keyring, ubuntu-archive-keyring)"
curl -fsIL --max-time 20 "$mirror/dists/$suite/Release" >/dev/null 2>&1 ||
    skip "$mirror cannot be reached"

# In mounts of our own, which end with this process.
if [ -z "${GRIPCAST_IN_NAMESPACE:-}" ]; then
    GRIPCAST_IN_NAMESPACE=1 exec unshare --mount --propagation private "$0" "$package" "$suite"
fi
scratch=$(mktemp -d)
root=$scratch/root
in_root=(chroot "$root" /usr/bin/env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root
    LC_ALL=C.UTF-8 DEBIAN_FRONTEND=noninteractive XDG_CONFIG_HOME=/etc)
in_service=("${in_root[@]}" setpriv --reuid gripcast --regid gripcast --init-groups --)
daemon=
cleanup() {
    [ -z "$daemon" ] || kill "$daemon" 2>/dev/null || true
    umount "$root/proc" 2>/dev/null || true
    rm -rf --one-file-system "$scratch"
}
trap cleanup EXIT

make_debian
install_package
check_system_files
check_token
try_program
try_daemon
remove_package
say "all held in $suite"
