#!/usr/bin/env bash
# Tests of the feature `gpu`, on whatever Vulkan driver is there; a software one
# (Debian: mesa-vulkan-drivers) will do. Where there is none, or no time, it says SKIPPED and why.
#
#   scripts/test_gpu.sh
#
# environment: GPU_TESTS_END_BY  seconds since 1970 by which to be done; no bound where unset
set -euo pipefail
cd "$(dirname "$0")/.."

skip() { printf 'SKIPPED: the tests of the feature gpu: %s\n' "$*"; exit 0; }

drivers=$(find /usr/share/vulkan/icd.d /usr/local/share/vulkan/icd.d /etc/vulkan/icd.d -name '*.json' \
    2>/dev/null | head -n 1 || true)
if [ -z "$drivers$(printenv VK_DRIVER_FILES VK_ICD_FILENAMES || true)" ]; then
    skip "no Vulkan driver (sudo apt-get install mesa-vulkan-drivers)"
fi

# Mesa puts its sockets and locks there, and complains where it is not set.
if [ -z "${XDG_RUNTIME_DIR:-}" ]; then
    XDG_RUNTIME_DIR=$(mktemp -d)
    export XDG_RUNTIME_DIR
    trap 'rm -rf "$XDG_RUNTIME_DIR"' EXIT
fi

# Seconds that are left; many where there is no bound.
left_s() { echo $((${GPU_TESTS_END_BY:-9999999999} - $(date +%s))); }

# A first build takes about ten minutes on two cores.
[ "$(left_s)" -ge 900 ] || skip "$(left_s) s are left, 900 are needed"

run() {
    local status=0
    timeout "$(left_s)" "$@" || status=$?
    [ "$status" != 124 ] || skip "out of time"
    return "$status"
}

run cargo test --locked --lib --features gpu -- --nocapture \
    render::gpu render::backend texsmooth::discriminator::burn
