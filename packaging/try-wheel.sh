#!/usr/bin/env bash
# packaging/try-wheel.sh WHEEL [SUITE…]: installs the wheel into a fresh Debian without a compiler,
# simulates a grasp there and runs the Python block of the README word for word.
#
# SUITE: bookworm and trixie unless named. Prints the time from `pip install` to the first simulated
# grasp. Needs root, a network and debootstrap; says SKIPPED and why without one of them, and ends with
# 0 then. GRIPCAST_MIRROR names another mirror. Exit codes: 0 all held or skipped · 1 something did not
# hold · 2 usage.
set -euo pipefail

say() { echo "try-wheel: $*" >&2; }
skip() {
    say "SKIPPED: $*"
    exit 0
}
[ $# -ge 1 ] || {
    echo "usage: packaging/try-wheel.sh WHEEL [SUITE…]" >&2
    exit 2
}
wheel=$(realpath "$1")
shift
cd "$(dirname "$0")/.."
suites=("$@")
[ ${#suites[@]} -gt 0 ] || suites=(bookworm trixie)
[ "$(id -u)" -eq 0 ] || skip "a chroot needs root"
command -v debootstrap >/dev/null || skip "debootstrap is not installed"
mirror=${GRIPCAST_MIRROR:-http://deb.debian.org/debian}
curl -fsIL --max-time 20 "$mirror/dists/${suites[0]}/Release" >/dev/null 2>&1 || skip "$mirror cannot be reached"

scratch=$(mktemp -d)
trap 'rm -rf --one-file-system "$scratch"' EXIT
for suite in "${suites[@]}"; do
    root=$scratch/$suite
    debootstrap --variant=minbase --include=python3,python3-venv,ca-certificates "$suite" "$root" "$mirror" >/dev/null
    cp /etc/resolv.conf "$root/etc/resolv.conf"
    cp "$wheel" "$root/tmp/"
    # This machine's certificates: its network may have a proxy with one of its own.
    cp /etc/ssl/certs/ca-certificates.crt "$root/tmp/certificates.crt"
    inside=(chroot "$root" /usr/bin/env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LC_ALL=C.UTF-8
        PIP_CERT=/tmp/certificates.crt)
    "${inside[@]}" python3 -c 'import shutil; assert not any(map(shutil.which, ("cc", "gcc", "cargo", "cmake")))'
    "${inside[@]}" python3 -m venv /opt/gripcast
    began=$(date +%s.%N)
    "${inside[@]}" /opt/gripcast/bin/pip install --quiet --disable-pip-version-check "/tmp/$(basename "$wheel")"
    found=$("${inside[@]}" /opt/gripcast/bin/python -c '
import gripcast as gc
ball = gc.Object(gc.Mesh.builtin("sphere"), mass_kg=0.06, friction=0.6)
print(gc.simulate(ball, gel="coarse", stop_force_n=12).outcome)')
    [ "$found" = success ] || {
        say "FAILED in $suite: the grasp was $found"
        exit 1
    }
    took=$(python3 -c "import sys; print(round(float(sys.argv[2]) - float(sys.argv[1]), 1))" "$began" "$(date +%s.%N)")
    say "$suite: $took s from pip install to the first simulated grasp"
    sed -n '/^```python$/,/^```$/{/^```/!p}' README.md >"$root/tmp/readme.py"
    "${inside[@]}" /opt/gripcast/bin/python /tmp/readme.py | sed "s/^/try-wheel: $suite: README: /" >&2
done
