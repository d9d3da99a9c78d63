#!/usr/bin/env bash
# Installs what gripcast needs to be built on Debian 12/13 and Ubuntu 22.04/24.04.
#   tools/setup.sh build   compiler, cmake, nasm, libclang, Rust toolchain
#   tools/setup.sh test    the same, and what the kernel tests build and boot, the Slurm of the
#                          cluster test, and the Python libraries that read what gripcast writes
#   tools/setup.sh package the same as build, and what makes packages
# Idempotent; asks apt only for what is missing; uses sudo when it is not root.
set -euo pipefail
cd "$(dirname "$0")/.."

want=${1:-build}
# cmake and nasm: libjpeg-turbo with SIMD. libclang: bindgen of the V4L2 headers. python3: checks of
# the documentation.
packages=(ca-certificates curl gcc g++ make pkg-config cmake nasm libclang-dev linux-libc-dev git python3)
case "$want" in
    build) ;;
    # The kernel of the kernel tests is built from the distribution's source; mandoc reads the
    # manual pages; the Python libraries live in an environment of their own.
    test) packages+=(flex bison bc libelf-dev xz-utils bzip2 mandoc python3-venv) ;;
    # dpkg-dev finds the libraries that a package depends on.
    package) packages+=(dpkg-dev) ;;
    *)
        echo "usage: tools/setup.sh build|test|package" >&2
        exit 2
        ;;
esac

# Packages that are not there; `missing` is set to them.
find_missing() {
    local package status
    missing=()
    for package in "$@"; do
        status=$(dpkg-query -W -f '${db:Status-Status}' "$package" 2>/dev/null || true)
        [ "$status" = installed ] || missing+=("$package")
    done
}
# Fails where that needs another user and there is no sudo.
as_root() {
    if [ "$(id -u)" -eq 0 ]; then
        "$@"
    elif command -v sudo >/dev/null; then
        sudo "$@"
    else
        return 1
    fi
}
apt_install() {
    echo "setup: installing $*" >&2
    as_root apt-get update -qq &&
        as_root env DEBIAN_FRONTEND=noninteractive \
            apt-get install -y -qq --no-install-recommends "$@" >/dev/null
}

# Slurm is no reason to have no other tests; GRIPCAST_REQUIRE_SLURM=1 makes it one.
without_slurm() {
    echo "SKIPPED: $1; the test on a Slurm cluster will be skipped" >&2
    [ -z "${GRIPCAST_REQUIRE_SLURM:-}" ]
}
install_slurm() {
    # It may be there without packages of these names.
    if command -v slurmctld >/dev/null && command -v munged >/dev/null; then
        return 0
    fi
    find_missing slurm-wlm munge
    [ ${#missing[@]} -gt 0 ] || return 0
    apt_install "${missing[@]}" ||
        without_slurm "Slurm could not be installed (as root: apt-get install ${missing[*]})"
}

if ! command -v dpkg-query >/dev/null || ! command -v apt-get >/dev/null; then
    echo "setup: no apt here; install the equivalents of: ${packages[*]}" >&2
else
    find_missing "${packages[@]}"
    if [ ${#missing[@]} -gt 0 ]; then
        apt_install "${missing[@]}" || {
            echo "setup: not installed; as root: apt-get install ${missing[*]}" >&2
            exit 1
        }
    fi
    if [ "$want" = test ] && [ -z "${GRIPCAST_SKIP_SLURM:-}" ]; then
        install_slurm
    fi
fi

# shellcheck disable=SC1091
[ -f "$HOME/.cargo/env" ] && . "$HOME/.cargo/env"
if ! command -v cargo >/dev/null; then
    echo "setup: installing rustup; rust-toolchain.toml pins the compiler" >&2
    curl --proto '=https' --tlsv1.2 -sSf https://sh.rustup.rs |
        sh -s -- -y -q --profile minimal --default-toolchain none
    . "$HOME/.cargo/env"
fi
# The first cargo call fetches the pinned toolchain where it is absent.
cargo --version >/dev/null || {
    version=$(sed -n 's/^channel = "\(.*\)"/\1/p' rust-toolchain.toml)
    echo "setup: cargo does not start; Rust $version is needed (rustup toolchain install $version)" >&2
    exit 1
}

# Without them their tests are skipped; GRIPCAST_REQUIRE_PYTHON=1 makes that an error.
without_python() {
    echo "SKIPPED: no Python libraries (network?); the tests $1 will be skipped" >&2
    [ -z "${GRIPCAST_REQUIRE_PYTHON:-}" ]
}
if [ "$want" = test ]; then
    [ -n "${GRIPCAST_PYTHON:-}" ] || tools/peers.sh install || without_python "with them"
    tools/python.sh install || without_python "of the Python package"
fi
