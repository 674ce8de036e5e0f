# SPDX-License-Identifier: Apache-2.0
# shellcheck shell=bash
# Waiting for a command, with an ear for signals to this script alone: bash keeps those to itself
# while a command runs, and leaves the command behind when it ends. Sourced, not run; needs Python.

status=0   # of what was attended
stopped=   # INT or TERM, once there was such a signal
_attended=
_again=

# pass_on_signals SIGNAL...: from now on these go to what is attended; of INT, TERM and HUP.
pass_on_signals() {
  local signal
  for signal; do
    case $signal in
      INT) trap '_pass_on INT' INT ;;
      *) trap '_pass_on TERM' "$signal" ;;
    esac
  done
}

_pass_on() {
  stopped=$1
  _again=true
  case $_attended-$1 in
    -*) ;;
    *-INT) interrupt "$_attended" ;;
    *) kill -"$1" "$_attended" 2> /dev/null || true ;;
  esac
}

# interrupt PID: as Ctrl-C does. To `child` that is nothing before its Python is there; what has not
# begun may just as well be ended.
interrupt() {
  local mask number=INT
  mask=$(sed -n 's/^SigIgn:[[:space:]]*//p' "/proc/$1/status" 2> /dev/null) || true
  if [[ -n $mask ]] && ((0x${mask: -1} & 2)); then number=TERM; fi
  kill -"$number" "$1" 2> /dev/null || true
}

# child COMMAND ...: what bash has run in the background ignores Ctrl-C and cannot change that; with
# this before it, it does not. (`env --default-signal` is missing in older systems.) And should the
# script be killed, it is interrupted.
child=(python3 -c 'import ctypes, os, signal, sys
for number in signal.SIGINT, signal.SIGQUIT:
    signal.signal(number, signal.SIG_DFL)
if sys.platform == "linux":
    ctypes.CDLL(None).prctl(1, signal.SIGINT)  # PR_SET_PDEATHSIG
os.execvp(sys.argv[1], sys.argv[1:])')

# attend COMMAND ARGUMENT...: runs it to its end and sets `status`.
attend() {
  # In the background, where bash would have it read nothing.
  "${child[@]}" "$@" <&0 &
  _attended=$!
  # Asked to end before there was anybody to tell; what has hardly begun does not hear of Ctrl-C yet.
  if [[ -n $stopped ]]; then kill -TERM "$_attended" 2> /dev/null || true; fi
  _again=true
  while $_again; do
    _again=false
    status=0
    wait "$_attended" || status=$?
  done
  _attended=
}
