#!/usr/bin/env bash
# Everything that must hold before a change is merged: format, lints, the compute-only build,
# documentation, all tests, those of the feature `gpu` where there is a Vulkan driver, and those of the
# feature `security` where there is OpenSSL. Needs Rust and a C compiler; tests against Python and npm
# peers install what they need under target/, and say SKIPPED where they cannot.
set -euo pipefail
cd "$(dirname "$0")/.."

step() { printf '\n==> %s\n' "$*"; "$@"; }

if ! command -v cc >/dev/null; then
    echo "A C compiler is missing (Rust links with it): sudo apt-get install build-essential" >&2
    exit 1
fi

step cargo fmt --check
step cargo clippy --locked --all-targets --quiet -- -D warnings
step cargo clippy --locked --lib --no-default-features --quiet -- -D warnings
RUSTDOCFLAGS="-D warnings" step cargo doc --locked --no-deps --quiet
step cargo test --locked --doc --quiet
if command -v cargo-nextest >/dev/null; then
    step cargo nextest run --locked --no-fail-fast --success-output=never
else
    step cargo test --locked --no-fail-fast --lib --bins --test all
fi
step scripts/test_gpu.sh
step scripts/test_security.sh
