#!/bin/sh
# Imitates ffprobe: prints a prepared answer.
PATH=/usr/bin:/bin
cat "$(dirname "$0")/../probe"
