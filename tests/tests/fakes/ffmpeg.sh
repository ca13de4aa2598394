#!/bin/sh
# Imitates ffmpeg: prints prepared grey frames, and writes a picture for each selected frame.
PATH=/usr/bin:/bin
here=$(dirname "$0")/..
case "$*" in
  *"-h long"*) cat "$here/ffmpeg-help"; exit 0;;
  *-filters*) echo " .SC zscale V->V x"; echo " .S. tonemap V->V x"; exit 0;;
  -version) echo "ffmpeg version 5.1.9 x"; exit 0;;
esac
{ printf 'ffmpeg'; for word in "$@"; do printf ' %s' "$word"; done; echo; } >> "$here/calls"
for word in "$@"; do
  [ "$before" = -i ] && film=$word
  [ "$before" = -vf ] && filter=$word
  before=$word
done
test -f "$film" || { echo "$film: No such file or directory" >&2; exit 1; }
case "$*" in
  *rawvideo*)
    [ -e "$here/fail-ffmpeg" ] && { echo "moov atom not found" >&2; exit 1; }
    if [ -e "$here/hang-ffmpeg" ]; then
      echo $$ > "$here/hanging"
      sleep 600
    fi
    cat "$here/showinfo" >&2
    cat "$here/raw";;
  *)
    number=0
    for frame in $(printf '%s' "$filter" | grep -o 'eq(n,[0-9]*' | sed 's/.*,//'); do
      number=$((number + 1))
      cp "$here/frames/$number.jpg" "$(printf "$before" $number)" || exit 1
      echo "frame=$number"
    done;;
esac
