#!/usr/bin/env bash
# Tests of the feature `security`: nodes with keys among peers with and without. Needs OpenSSL's headers,
# pkg-config and openssl (Debian: libssl-dev pkg-config openssl); says SKIPPED where they are missing.
#
#   scripts/test_security.sh
#
# environment: SECURITY_TESTS_END_BY  seconds since 1970 by which to be done; no bound where unset
set -euo pipefail
cd "$(dirname "$0")/.."

skip() { printf 'SKIPPED: the tests of the feature security: %s\n' "$*"; exit 0; }

command -v openssl >/dev/null || skip "no openssl"
command -v pkg-config >/dev/null || skip "no pkg-config"
pkg-config --exists openssl || skip "no OpenSSL headers (sudo apt-get install libssl-dev)"

# Seconds that are left; many where there is no bound.
left_s() { echo $((${SECURITY_TESTS_END_BY:-9999999999} - $(date +%s))); }

# A first build takes some minutes on two cores.
[ "$(left_s)" -ge 420 ] || skip "$(left_s) s are left, 420 are needed"

run() {
    local status=0
    timeout "$(left_s)" "$@" || status=$?
    [ "$status" != 124 ] || skip "out of time"
    return "$status"
}

# What is tested is the DDS beneath and few lines of ours: unoptimised they build in half the time.
run cargo test --locked --lib --features security --config 'profile.dev.package.veneer.opt-level=0' \
    --config 'profile.dev.package.rustdds.opt-level=0' -- \
    --nocapture ros::security
