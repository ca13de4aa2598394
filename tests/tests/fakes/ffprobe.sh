#!/bin/sh
# Imitates ffprobe.
PATH=/usr/bin:/bin
cat "$(dirname "$0")/../probe"
