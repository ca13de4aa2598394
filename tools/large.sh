#!/usr/bin/env bash
# A test of large data sets: many large photographs, kept in memory and in a file, must train to the same bits.
#
#     tools/large.sh COUNT WIDTH HEIGHT [FOLDER]
#
# Prints the seconds and the peak memory of each run. FOLDER (default: a new temporary one) needs room for the photographs and,
# for the file, 5.4 bytes per pixel. The run in memory is skipped if the photographs exceed the available memory.
set -euo pipefail
[ $# -ge 3 ] || { sed -n '2,8s/^# \{0,1\}//p' "$0"; exit 2; }
count=$1 width=$2 height=$3 folder=${4:-$(mktemp -d)}
cd "$(dirname "$0")/.."
cargo build --release --locked -q -p trimip-cli
[ -e "$folder/scene/transforms.json" ] \
  || cargo run --release --locked -q -p trimip-tests --example large_scene -- "$folder/scene" "$count" "$width" "$height"
export TMPDIR="$folder"

# Trains 50 steps with `data.pixels` set to $1, and prints time and peak memory.
train() {
  local begin=$SECONDS
  target/release/trimip-cli "$folder/scene" --set data.most_pixels=1e11 --set data.pixels="$1" --set train.steps=50 \
    --set train.samples_per_step=32768 --set eval.points=0 --set eval.final=0 --out "$folder/$1" --fresh >"$folder/$1.log"
  echo "$1: $((SECONDS - begin)) s, peak memory $(sed -n 's/.*"peak_memory_bytes": *\([0-9]*\).*/\1/p' "$folder/$1/report.json" | head -1) bytes"
}

# Prints the tensors of the model in $1, without the header, which contains its settings.
tensors() {
  local model="$folder/$1/model.safetensors"
  tail -c "+$((9 + $(od -An -t u8 -N 8 "$model")))" "$model"
}

train disk
available=$(sed -n 's/MemAvailable: *\([0-9]*\) kB/\1/p' /proc/meminfo)
if [ $((count * width * height * 54 / 10240)) -gt "$available" ]; then
  echo "memory: skipped, the photographs are larger than the available memory"
else
  train memory
  cmp <(tensors disk) <(tensors memory) && echo "same bits"
fi
