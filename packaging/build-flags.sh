# Sourced for builds of packages: the binary names no folder of the machine it is made on.
# Compilers replace the folders below in panic messages, assertions and line tables. Cargo keeps
# what is built with these flags beside what is built without them.
#
# cargo's registry → /cargo, this checkout → /gripcast, the home folder → /home
_remap() {
    local from=$1 to=$2
    # "/" would be replaced everywhere.
    case $from in '' | /) return ;; esac
    _rust+=("--remap-path-prefix=$from=$to")
    _c+=" -ffile-prefix-map=$from=$to"
}
_rust=() _c=
if [ -n "${RUSTFLAGS:-}" ]; then
    read -ra _rust <<<"$RUSTFLAGS"
fi
# Of several that fit, the last one counts.
_remap "${HOME:-}" /home
_remap "${CARGO_HOME:-${HOME:-}/.cargo}" /cargo
_remap "$PWD" /gripcast
_remap "${CARGO_TARGET_DIR:-}" /gripcast/target
# Not RUSTFLAGS, which divides a path at its blanks.
CARGO_ENCODED_RUSTFLAGS=$(IFS=$'\x1f' && printf %s "${_rust[*]}")
export CARGO_ENCODED_RUSTFLAGS CFLAGS="${CFLAGS:-}$_c" CXXFLAGS="${CXXFLAGS:-}$_c"
unset -f _remap
unset _rust _c
