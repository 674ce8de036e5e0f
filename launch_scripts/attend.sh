# SPDX-License-Identifier: Apache-2.0
# shellcheck shell=bash
# Runs a command and passes on signals that are sent to the script alone. By itself, bash would not
# handle them until the command ends, or would end and leave the command running. Sourced, not run;
# needs Python.

status=0   # exit status of the command
stopped=   # INT or TERM, after such a signal
_attended=
_again=

# pass_on_signals SIGNAL...: from now on, passes these signals (INT, TERM or HUP) on to the command.
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

# interrupt PID: interrupts a process as Ctrl-C does. Until Python runs in `child`, the process ignores
# SIGINT; it has not done anything yet, so it gets SIGTERM instead.
interrupt() {
  local mask number=INT
  mask=$(sed -n 's/^SigIgn:[[:space:]]*//p' "/proc/$1/status" 2> /dev/null) || true
  if [[ -n $mask ]] && ((0x${mask: -1} & 2)); then number=TERM; fi
  kill -"$number" "$1" 2> /dev/null || true
}

# child COMMAND ...: a prefix for commands that run in the background. Bash makes these ignore Ctrl-C;
# this prefix undoes that. (Older systems lack `env --default-signal`.) If the script is killed, the
# command receives SIGINT.
child=(python3 -c 'import ctypes, os, signal, sys
for number in signal.SIGINT, signal.SIGQUIT:
    signal.signal(number, signal.SIG_DFL)
if sys.platform == "linux":
    ctypes.CDLL(None).prctl(1, signal.SIGINT)  # PR_SET_PDEATHSIG
os.execvp(sys.argv[1], sys.argv[1:])')

# attend COMMAND ARGUMENT...: runs the command to its end and sets `status`.
attend() {
  # In the background, bash would redirect standard input from /dev/null.
  "${child[@]}" "$@" <&0 &
  _attended=$!
  # A signal arrived before the command had started. It may still ignore SIGINT, so send SIGTERM.
  if [[ -n $stopped ]]; then kill -TERM "$_attended" 2> /dev/null || true; fi
  _again=true
  while $_again; do
    _again=false
    status=0
    wait "$_attended" || status=$?
  done
  _attended=
}
