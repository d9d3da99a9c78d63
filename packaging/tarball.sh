#!/usr/bin/env bash
# packaging/tarball.sh BINARY STAGED OUT: gripcast-VERSION-MACHINE-linux.tar.gz and SHA256SUMS in
# OUT, from a binary and what packaging/stage.sh wrote. The same bytes for the same sources and
# SOURCE_DATE_EPOCH.
set -euo pipefail
[ $# -eq 3 ] || {
    echo "usage: packaging/tarball.sh BINARY STAGED OUT" >&2
    exit 2
}
binary=$(realpath "$1")
staged=$(realpath "$2")
mkdir -p "$3"
out=$(realpath "$3")
cd "$(dirname "$0")/.."
: "${SOURCE_DATE_EPOCH:=$(git log -1 --format=%ct)}"

# Only the C library and what comes with it: everything else is linked in.
allowed='^(libc|libm|libgcc_s|ld-linux-x86-64|ld-linux-aarch64)\.so\.[0-9]+$'
mapfile -t needed < <(readelf -d "$binary" | sed -n 's/.*(NEEDED).*\[\(.*\)\]/\1/p')
for library in "${needed[@]}"; do
    if ! [[ $library =~ $allowed ]]; then
        echo "tarball: the binary needs $library, which other machines may lack" >&2
        exit 1
    fi
done
glibc=$(objdump -T "$binary" | grep -o 'GLIBC_[0-9.]*' | sort -Vu | tail -1)

version=$("$binary" --version | cut -d' ' -f2)
name=gripcast-$version-$(uname -m)-linux
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
root=$scratch/$name
install -Dm755 "$binary" "$root/bin/gripcast"
strip --strip-all "$root/bin/gripcast"
install -Dm644 -t "$root" README.md CHANGELOG.md LICENSE-MIT LICENSE-APACHE
gunzip -c "$staged/THIRD-PARTY.txt.gz" >"$root/THIRD-PARTY.txt"
install -Dm644 -t "$root/share/man/man1" "$staged"/man/*.1
install -Dm644 "$staged/completions/gripcast.bash" \
    "$root/share/bash-completion/completions/gripcast"
install -Dm644 -t "$root/share/zsh/site-functions" "$staged/completions/_gripcast"
install -Dm644 -t "$root/share/fish/vendor_completions.d" "$staged/completions/gripcast.fish"
install -Dm644 -t "$root/packaging" packaging/70-gripcast.rules packaging/gripcast.service \
    packaging/config.toml packaging/deb/gripcast.sysusers
install -Dm644 -t "$root/docs" docs/*.md
for kind in tutorial how-to reference explanation; do
    install -Dm644 -t "$root/docs/$kind" "docs/$kind"/*
done
install -Dm644 -t "$root/examples" tests/data/three-grasps.txt
chmod -R u=rwX,go=rX "$root"

tar --create --directory "$scratch" --sort=name --format=ustar --mtime="@$SOURCE_DATE_EPOCH" \
    --owner=0 --group=0 --numeric-owner "$name" | gzip -9n >"$out/$name.tar.gz"
(cd "$out" && sha256sum "$name.tar.gz" >SHA256SUMS)
echo "$out/$name.tar.gz needs ${needed[*]} (${glibc/_/ } or later)"
