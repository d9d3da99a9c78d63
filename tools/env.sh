# Sourced by the Makefile: makes a freshly installed toolchain visible without a new login.
if [ -f "$HOME/.cargo/env" ]; then
    . "$HOME/.cargo/env"
fi
