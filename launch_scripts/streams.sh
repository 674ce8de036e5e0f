# SPDX-License-Identifier: Apache-2.0
# shellcheck shell=bash
# Makes a command of this folder safe with closed standard streams: the next opened file would get the descriptor of
# a closed one and receive its output. Sourced.
[ -e /dev/fd/0 ] || exec < /dev/null
# Bash leaves its script open, for reading, in the place of a closed standard error.
if ! [ -e /dev/fd/2 ] || [ /dev/fd/2 -ef "$0" ]; then exec 2> /dev/null; fi
if ! [ -e /dev/fd/1 ]; then
  echo "${0##*/}: standard output: it is closed, expected a terminal, file or pipe" >&2
  exit 2
fi
