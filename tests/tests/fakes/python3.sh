#!/bin/sh
# Imitates a Python with pycolmap: runs the named stage of the script.
PATH=/usr/bin:/bin
here=$(dirname "$0")/..
if [ "$1" = -c ]; then
  cat "$here/pycolmap" 2>/dev/null || { echo "ModuleNotFoundError: No module named 'pycolmap'" >&2; exit 1; }
  exit 0
fi
echo "pycolmap $2 $3" >> "$here/calls"
test -s "$1" || exit 4
value() { printf '%s' "$2" | sed "s/.*\"$1\":\"\([^\"]*\)\".*/\1/"; }
database=$(value database "$3")
case "$2" in
  features) echo features > "$database";;
  exhaustive|sequential) echo "$2 matches" >> "$database";;
  pairs) echo loops >> "$database";;
  incremental|global) cp -R "$here/models/." "$(value models "$3")";;
  *) exit 5;;
esac
