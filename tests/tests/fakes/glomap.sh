#!/bin/sh
# Imitates glomap: logs its call, and copies a prepared model.
PATH=/usr/bin:/bin
here=$(dirname "$0")/..
echo "glomap $*" >> "$here/calls"
[ "$1" = mapper ] && [ "$6" = --output_path ] && cp -R "$here/models/." "$7"
