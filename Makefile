# make run    build and open the collect screen on the built-in virtual rig
# make test   everything: format, lints, unit, integration, crash, real-kernel, Slurm and Python tests
# make deb    a Debian package, target/debian/*.deb
# make tarball  an archive for other Linux machines, target/tarball/*.tar.gz
# make docs   the documentation as a book, target/book/html/index.html
# make python  build the Python package, run its tests, check its types
# make wheel  the Python package for other Linux machines, target/wheels
# All install what they need first (apt through sudo when not root, pinned Rust toolchain).

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help

CARGO := . tools/env.sh; cargo
DATASET ?= demo-dataset

.PHONY: help run test test-fast test-peers python wheel lint docs bench kernel setup setup-test setup-package package-files deb try-deb tarball

help:
	@sed -n 's/^# \(make .*\)/\1/p' $(MAKEFILE_LIST)
	@echo "make test-fast   tests without kernel and Slurm; make test-peers   longer checks against other"
	@echo "programs' libraries; make bench   all measurements"

setup:
	@tools/setup.sh build

setup-test:
	@tools/setup.sh test

setup-package:
	@tools/setup.sh package

# Without a terminal this is often a busy machine, which paints the virtual cameras late: the
# scripted run has wider guards.
run: setup
	@$(CARGO) build --release --bin gripcast
	@if [ -t 0 ] && [ -t 1 ]; then \
	    exec target/release/gripcast collect --rig virtual --dataset "$(DATASET)"; \
	else \
	    echo "no terminal: running the scripted three grasps" >&2; \
	    GRIPCAST__GUARDS__MAX_FRAME_AGE_MS=2000 GRIPCAST__GUARDS__MAX_SKEW_MS=2000 \
	        target/release/gripcast collect --rig virtual --script tests/data/three-grasps.txt \
	        --seed "$$(ls "$(DATASET)/grasps" 2>/dev/null | wc -l)" --dataset "$(DATASET)"; \
	    target/release/gripcast dataset verify "$(DATASET)"; \
	fi

lint: setup
	@python3 tools/docs.py check
	@python3 tools/lint-prose.py --self-test
	@python3 tools/lint-prose.py
	@tools/spell.sh
	@$(CARGO) fmt --check
	@tools/deny.sh
	@$(CARGO) clippy --workspace --all-targets -- -D warnings

docs: setup
	@tools/docs.sh

# A kernel that cannot be built (no network, not x86-64) is said loudly and does not hide the
# other tests; GRIPCAST_REQUIRE_KERNEL=1 makes it an error.
kernel: setup-test
	@tests/kernel/build-kernel.sh || { \
	    echo "SKIPPED: the test kernel could not be built; the real-kernel tests will be skipped" >&2; \
	    [ -z "$${GRIPCAST_REQUIRE_KERNEL:-}" ]; }

# Ends with a summary of what was skipped; GRIPCAST_REQUIRE_KERNEL, _SLURM, _SHARED, … = 1 make that
# a failure.
test: setup-test lint kernel
	@tools/run-tests.sh

test-fast: lint
	@GRIPCAST_SKIP_KERNEL=1 GRIPCAST_SKIP_SLURM=1 tools/run-tests.sh

test-peers: setup-test
	@$(CARGO) build --release --bin gripcast
	@tools/test-peers.sh

python: setup
	@tools/python.sh

wheel: setup
	@tools/wheel.sh

bench: setup
	@$(CARGO) build --release --bin gripcast
	@target/release/gripcast bench live --json
	@target/release/gripcast bench predict --json
	@$(CARGO) bench -p gripcast-bench

# The time of everything in a package is that of the commit: the same bytes on every run.
package-files deb tarball: export SOURCE_DATE_EPOCH ?= $(shell git log -1 --format=%ct || echo 0)

# Names of source files of the assembler stand in the symbol table.
package-files: setup-package
	@. tools/env.sh; . packaging/build-flags.sh; cargo build --release --locked --bin gripcast
	@strip --strip-all target/release/gripcast
	@packaging/check-paths.sh target/release/gripcast
	@. tools/env.sh; packaging/stage.sh target/release/gripcast target/package

CARGO_DEB := 3.8.0
deb: package-files
	@. tools/env.sh; cargo deb --version 2>/dev/null | grep -qF "$(CARGO_DEB)" || \
	    cargo install --quiet --locked cargo-deb@$(CARGO_DEB)
	@$(CARGO) deb --no-build --strip --locked --output target/debian/

try-deb: deb
	@packaging/try-in-chroot.sh "$$(ls -t target/debian/*.deb | head -1)"

tarball: package-files
	@packaging/tarball.sh target/release/gripcast target/package target/tarball
