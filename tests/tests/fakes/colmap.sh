#!/bin/sh
# Imitates colmap: logs its calls, accepts only the options of its help, and copies a prepared model.
PATH=/usr/bin:/bin
here=$(dirname "$0")/..
command=$1
case "$command" in
  help) cat "$here/help"; exit 0;;
esac
shift
if [ "$1" = --help ]; then
  cat "$here/help-$command"
  exit 0
fi
{ printf 'colmap %s' "$command"; for word in "$@"; do printf ' %s' "$word"; done; echo; } >> "$here/calls"
while [ $# -gt 1 ]; do
  grep -q -e "$1 " "$here/help-$command" || { echo "unrecognised option '$1'" >&2; exit 1; }
  case "$1" in
    --database_path) database=$2;;
    --image_path) images=$2;;
    --output_path) out=$2;;
    --Mapper.ba_refine_extra_params) undistorted=1;;
  esac
  shift 2
done
if [ -e "$here/hang-$command" ]; then
  # Writes half of the output.
  if [ -n "$out" ]; then echo half > "$out/half"; else echo half >> "$database"; fi
  echo $$ > "$here/hanging"
  sleep 600
fi
if [ -e "$here/fail-$command" ]; then
  echo "begins" >&2
  cat "$here/fail-$command" >&2
  exit 1
fi
case "$command" in
  feature_extractor)
    number=0
    all=$(ls "$images" | wc -l)
    for image in "$images"/*; do
      number=$((number + 1))
      echo "Processed file [$number/$all]"
    done
    echo features > "$database";;
  *matcher)
    grep -q features "$database" || exit 3
    echo "Matching block [1/1, 1/1] in 0.1s"
    echo "$command" >> "$database";;
  matches_importer)
    echo loops >> "$database";;
  mapper|global_mapper)
    grep -q match "$database" || exit 3
    echo "Registering image #1 (3)"
    [ -d "$here/models" ] || { echo "failed to create sparse model"; exit 1; }
    if [ -n "$undistorted" ] && [ -d "$here/undistorted" ]; then here=$here/undistorted; fi
    cp -R "$here/models/." "$out";;
esac
