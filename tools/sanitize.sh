#!/usr/bin/env bash
# The tests of unsafe code under AddressSanitizer: products, lanes of every instruction set that this processor has, photographs
# in a mapped file; with `all` the gathers of the encoders too. Needs the sanitizer's runtime, which comes with the compiler for
# Linux and macOS; elsewhere this says so and does nothing.
#
#     tools/sanitize.sh [all]     # all: also the conformance of every stage, some minutes more
set -euo pipefail
cd "$(dirname "$0")/.."
host=$(rustc -vV | sed -n 's/^host: //p')
if ! ls "$(rustc --print sysroot)/lib/rustlib/$host/lib/"*rt.asan* >/dev/null 2>&1; then
  echo "this compiler has no AddressSanitizer for $host: skipped"
  exit
fi
# The option is unstable, and the compiler's own runtime is stable.
export RUSTC_BOOTSTRAP=1 RUSTFLAGS="-Zsanitizer=address"
# Little is optimized here: what is tested runs for seconds and builds for minutes.
under_asan() {
  CARGO_PROFILE_DEV_OPT_LEVEL=1 cargo test --locked --target "$host" --target-dir target/asan --config 'profile.dev.package."*".opt-level=0' "$@"
}
under_asan -p trimip-cpu -p trimip-data --lib
# Finite differences ask the reference most of the time, which is safe code.
if [ "${1:-}" = all ]; then
  under_asan -p trimip-tests --no-default-features --test conformance -- --skip finite_differences
fi
