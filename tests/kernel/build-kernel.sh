#!/usr/bin/env bash
# Builds the User-Mode-Linux kernel of the kernel tests from the distribution's own kernel source
# and keeps it in ${GRIPCAST_CACHE:-~/.cache/gripcast}/uml/<source version>-<fragment>/umlinux.
# Prints that path. Returns at once when it is there; else takes 4 to 8 minutes on two cores,
# 2 GB of disk while it builds, and downloads about 140 MB.
#
# Needs apt (Debian 12/13, Ubuntu 22.04/24.04) on x86-64 and the packages
#   gcc make flex bison bc libelf-dev xz-utils bzip2
# Exit status: 0 the kernel is there, 75 it cannot be built here or now, 1 the build failed.
set -euo pipefail

here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
fragment=$here/uml.fragment
cache=${GRIPCAST_CACHE:-$HOME/.cache/gripcast}/uml
fragment_sha=$(sha256sum "$fragment" | cut -c1-12)

say() { echo "build-kernel: $*" >&2; }
cannot() {
    say "NO TEST KERNEL: $*"
    exit 75
}
as_root() {
    if [ "$(id -u)" -eq 0 ]; then "$@"; else sudo -n "$@"; fi
}

[ "$(uname -sm)" = "Linux x86_64" ] || cannot "User Mode Linux is built on x86-64 Linux only, this is $(uname -sm)"

# A kernel of any source version with this very configuration will do where apt is out of reach.
cached_any() { find "$cache" -path "*-$fragment_sha/umlinux" 2>/dev/null | sort -V | tail -n 1; }

source_package() {
    apt-cache depends linux-source 2>/dev/null |
        sed -n 's/^ *Depends: \(linux-source-[0-9.]*\)$/\1/p' | head -n 1
}

if ! command -v apt-cache >/dev/null; then
    found=$(cached_any)
    [ -n "$found" ] || cannot "no apt here; it knows the distribution's kernel source"
    echo "$found"
    exit 0
fi
package=$(source_package)
if [ -z "$package" ]; then
    as_root apt-get update -qq || true
    package=$(source_package)
fi
[ -n "$package" ] || cannot "apt knows no linux-source package; is the network there, are the sources set?"
version=$(apt-cache show --no-all-versions "$package" | sed -n 's/^Version: //p' | head -n 1)
home=$cache/$(tr -c 'A-Za-z0-9.+\n-' '_' <<<"$version")-$fragment_sha
if [ -x "$home/umlinux" ]; then
    echo "$home/umlinux"
    exit 0
fi

for tool in gcc make flex bison bc xz; do
    command -v $tool >/dev/null || cannot "\`$tool\` is missing (tools/setup.sh test installs what is needed)"
done
mkdir -p "$cache"
exec 9>"$cache/lock"
flock 9
if [ -x "$home/umlinux" ]; then
    echo "$home/umlinux"
    exit 0
fi

work=$(mktemp -d "$cache/build.XXXXXX")
trap 'rm -rf "$work"' EXIT
cd "$work"

say "fetching $package $version"
apt-get download -qq "$package=$version" >&2 || {
    as_root apt-get update -qq && apt-get download -qq "$package" >&2
} || cannot "$package could not be downloaded"

say "unpacking"
dpkg-deb --fsys-tarfile ./*.deb | tar -x --wildcards '*/linux-source-*.tar.*'
rm -f ./*.deb
tarball=$(find usr -type f -name 'linux-source-*.tar.*' | head -n 1)
[ -n "$tarball" ] || cannot "$package holds no source archive"
mkdir source build
# Other architectures' code and the largest register tables are a third of the bytes; every
# Kconfig file has to stay.
tar -xf "$tarball" -C source --strip-components=1 \
    --exclude='*/arch/[a-t]*/boot/*' --exclude='*/arch/[a-t]*/include/*' \
    --exclude='*/drivers/gpu/drm/amd/include/*' --exclude='*/tools/testing/*'
rm -f "$tarball"

# Prints the end of the log where a step fails.
logged() {
    "$@" >>"$home.log" 2>&1 || {
        tail -n 20 "$home.log" >&2
        say "the build failed, see $home.log"
        exit 1
    }
}
configure() {
    make -C source ARCH=um O="$work/build" allnoconfig &&
        (cd build && ../source/scripts/kconfig/merge_config.sh -m .config "$fragment") &&
        make -C build ARCH=um olddefconfig
}
# Before the long step: a newer kernel may have put an option behind another one.
check_options() {
    local option dropped=()
    for option in USB_VIDEO_CLASS USBIP_VHCI_HCD HIDRAW USB_HID HOSTFS UML_TIME_TRAVEL_SUPPORT; do
        grep -q "^CONFIG_$option=y" build/.config || dropped+=("CONFIG_$option")
    done
    [ ${#dropped[@]} -eq 0 ] || {
        say "the configuration of $version lacks ${dropped[*]}: what they depend on is missing in $fragment"
        exit 1
    }
}
# The first make can stop on configuration remembered from allnoconfig; the second goes on.
compile() {
    make -C build ARCH=um -j"$(nproc)" linux || make -C build ARCH=um -j"$(nproc)" linux
}

say "building with $(nproc) jobs; the log is in $home.log"
: >"$home.log"
logged configure
check_options
logged compile

mkdir -p "$home"
strip -o "$home/umlinux.new" build/linux
mv "$home/umlinux.new" "$home/umlinux"
say "done: $(du -h "$home/umlinux" | cut -f1)"
echo "$home/umlinux"
