#!/usr/bin/env bash
# Runs the tests of unsafe code under AddressSanitizer: matrix products, lanes of every instruction set of this processor, photographs
# in a mapped file, and with `all` the gathers of the encoders. Needs the sanitizer's runtime, which comes with the compiler for
# Linux and macOS; on other systems the script says so and does nothing.
#
#     tools/sanitize.sh [all]     # all: also the conformance of every stage, some minutes more
set -euo pipefail
cd "$(dirname "$0")/.."
host=$(rustc -vV | sed -n 's/^host: //p')
if ! ls "$(rustc --print sysroot)/lib/rustlib/$host/lib/"*rt.asan* >/dev/null 2>&1; then
  echo "this compiler has no AddressSanitizer for $host: skipped"
  exit
fi
# The option is unstable, but the compiler ships the runtime with stable releases too.
export RUSTC_BOOTSTRAP=1 RUSTFLAGS="-Zsanitizer=address"
# Optimisation is low: the tests run for seconds and build for minutes.
under_asan() {
  CARGO_PROFILE_DEV_OPT_LEVEL=1 cargo test --locked --target "$host" --target-dir target/asan --config 'profile.dev.package."*".opt-level=0' "$@"
}
under_asan -p trimip-cpu -p trimip-data --lib
# Finite differences are skipped: they spend most of the time in the reference, which is safe code.
if [ "${1:-}" = all ]; then
  under_asan -p trimip-tests --no-default-features --test conformance -- --skip finite_differences
fi
