#!/usr/bin/env bash
# Builds the program of the page of `trimip-cli export web` into target/web: trimip-web as WebAssembly, with bindings by wasm-bindgen.
set -euo pipefail
cd "$(dirname "$0")/.."

target=wasm32-unknown-unknown
rustup target add $target >/dev/null 2>&1 || true
# The tool and the crate must have the same version.
version=$(sed -n '/^name = "wasm-bindgen"$/{n;s/version = "\(.*\)"/\1/p}' Cargo.lock)
tool=target/tools/bin/wasm-bindgen
if [ "$("$tool" --version 2>/dev/null)" != "wasm-bindgen $version" ]; then
  # Without optimisation, the tool builds in a third of the time and still runs in a second.
  cargo install --quiet --debug wasm-bindgen-cli --version "$version" --root target/tools
fi
cargo build --quiet --locked --profile web --target $target -p trimip-web
"$tool" --target web --no-typescript --out-dir target/web target/$target/web/trimip_web.wasm
ls -l target/web | awk 'NF > 8 {print $9 ": " $5 " bytes"}'
echo "compressed: $(gzip -9 -c target/web/trimip_web_bg.wasm | wc -c) bytes"
