#!/usr/bin/env bash
# Trains for many steps and records, every ten seconds, resident memory, open files, threads and the step, as CSV.
#
#     tools/long.sh FOLDER [STEPS [SAMPLES_PER_STEP [OUT]]]
#
# Defaults: 100,000 steps of 8,192 samples. `TRIMIP` is the path of the program; without it, the release build is made and used.
# Finally prints the first and the last quarter for comparison: memory and open files must not grow, the rate must not fall.
set -euo pipefail
[ $# -ge 1 ] || { sed -n '2,8s/^# \{0,1\}//p' "$0"; exit 2; }
data=$(realpath "$1") steps=${2:-100000} samples=${3:-8192}
out=$(realpath -m "${4:-$(mktemp -d)}")
cd "$(dirname "$0")/.."
mkdir -p "$out"
program=${TRIMIP:-}
[ -n "$program" ] || { cargo build --release --locked -q -p trimip-cli; program=target/release/trimip-cli; }

"$program" "$data" --set train.steps="$steps" --set train.samples_per_step="$samples" --set eval.points=0 \
  --set eval.time_fraction=0 --set eval.final=25 --out "$out/run" >"$out/log" &
pid=$!
trap 'kill "$pid" 2>/dev/null || true' EXIT
echo "second,resident_kb,open_files,threads,step" >"$out/watch.csv"
while kill -0 "$pid" 2>/dev/null; do
  resident=$(awk '/VmRSS/ {print $2}' "/proc/$pid/status" 2>/dev/null || true)
  threads=$(awk '/Threads/ {print $2}' "/proc/$pid/status" 2>/dev/null || true)
  step=$(tail -n 1 "$out/log" | sed -n 's/.*"kind":"step","totals":{"step":\([0-9]*\).*/\1/p')
  [ -z "$resident" ] || [ -z "$step" ] \
    || echo "$SECONDS,$resident,$(ls "/proc/$pid/fd" 2>/dev/null | wc -l),$threads,$step" >>"$out/watch.csv"
  sleep 10
done
trap - EXIT
code=0
wait "$pid" || code=$?
echo "exit code $code; the watch is in $out/watch.csv"
awk -F, 'NR > 1 { n++; at[n] = $1; kb[n] = $2; files[n] = $3; threads[n] = $4; step[n] = $5 }
  function quarter(from, to,   i, most, open, tasks) {
    for (i = from; i <= to; i++) {
      if (kb[i] > most) most = kb[i]
      if (files[i] > open) open = files[i]
      if (threads[i] > tasks) tasks = threads[i]
    }
    printf "steps %d to %d: at most %.0f MB, %d open files, %d threads, %.1f steps/s\n", step[from], step[to], most / 1000,
      open, tasks, (step[to] - step[from]) / (at[to] - at[from])
  }
  END { q = int(n / 4); if (q < 2) { print "too short to compare quarters"; exit } quarter(1, q); quarter(n - q + 1, n) }' "$out/watch.csv"
exit "$code"
