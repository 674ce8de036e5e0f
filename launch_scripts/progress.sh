# SPDX-License-Identifier: Apache-2.0
# shellcheck shell=bash disable=SC2154
# Output of set-up: steps with elapsed time on stderr, and failures in a line or two. Sourced.

ticker=

# fail LINE...: prints what is wrong and what to do next, one line each, and exits with status 1.
fail() {
  printf 'setup: %s\n' "$1" >&2
  shift
  local line
  for line in "$@"; do printf '       %s\n' "$line" >&2; done
  exit 1
}

# doze: sleeps for a second, so that tick can end at once without leaving a sleep process behind.
# Fails if set-up has ended.
doze() {
  sleep 1 > /dev/null 2>&1 &
  nap=$!
  wait "$nap"
  [[ $(cut -d ' ' -f 4 "/proc/$me/stat") == "$$" ]]
}

# tick TEXT: keeps updating the line of one step with the elapsed time and the latest entry in the log.
tick() {
  local started=$SECONDS last width nap='' me=$BASHPID
  trap '[[ -z $nap ]] || kill "$nap" 2> /dev/null; exit 0' TERM
  if [[ ! -t 2 ]]; then
    while doze; do
      (((SECONDS - started) % 30)) ||
        printf '  %s: still running, %d s\n' "$1" "$((SECONDS - started))" >&2
    done
    return
  fi
  width=$(stty size < /dev/tty 2> /dev/null | cut -d ' ' -f 2) || width=80
  ((${width:-0} > 20)) || width=80
  while :; do
    last=$(tail -c 2000 "$log" 2> /dev/null | tr '\r' '\n' |
      grep -aoE '^ *(Collecting [^ ]+|Downloading [^ ]+|Installing collected|\[[0-9]+/[0-9]+\])' |
      tail -n 1) || last=
    last=$(printf '  %s ... %d s  %s' "$1" "$((SECONDS - started))" "${last## }")
    printf '\r\033[K%s' "${last:0:width-1}" >&2
    doze || return
  done
}

end_tick() {
  [[ -n $ticker ]] || return 0
  kill "$ticker" 2> /dev/null || true
  wait "$ticker" 2> /dev/null || true
  ticker=
  if [[ -t 2 ]]; then printf '\r\033[K' >&2; fi
}

# end_step: interrupts the command of a step, and kills what is left of it after five seconds.
end_step() {
  local tries job working=
  # The command is the only job beside the ticker. A variable with its process id would be set late: a signal may arrive
  # right after the command has started.
  for job in $(jobs -p); do
    [[ $job == "$ticker" ]] || working=$job
  done
  [[ -n $working ]] || return 0
  # If it has no group yet, it has not begun.
  kill -INT -- "-$working" 2> /dev/null || kill "$working" 2> /dev/null || true
  for ((tries = 0; tries < 50; tries++)); do
    kill -0 -- "-$working" 2> /dev/null || return 0
    sleep 0.1
  done
  kill -KILL -- "-$working" 2> /dev/null || true
}

# interrupted STATUS: ends set-up after a signal.
interrupted() {
  trap '' INT TERM HUP
  end_step
  end_tick
  echo 'setup: interrupted; run it again to continue.' >&2
  exit "$1"
}

# step TEXT COMMAND...: runs the command with its output in the log; returns its status.
step() {
  local text=$1 started=$SECONDS status=0
  shift
  printf '\n### %s\n' "$text" >> "$log"
  [[ -t 2 ]] || printf '  %s ...\n' "$text" >&2
  tick "$text" 9>&- &
  ticker=$!
  # In the foreground, it would delay the traps of signals to its end. In the background, bash makes it ignore SIGINT;
  # the trap undoes that.
  (trap - INT; exec setsid "$@") < /dev/null >> "$log" 2>&1 &
  wait "$!" || status=$?
  end_tick
  if ((status == 0)); then printf '  %s: done in %d s\n' "$text" "$((SECONDS - started))" >&2; fi
  return "$status"
}

# explain WHAT: prints the reason that the log gives for a failed step, and exits with status 1.
explain() {
  local tail
  tail=$(tail -n 200 "$log")
  case $tail in
    *'No space left on device'* | *'Errno 28'*)
      fail "$1 failed: the disk is full." 'Free some space (about 4 GB are needed), then run it again.' ;;
    *'Errno -3'* | *'Errno -2'* | *'Failed to establish a new connection'* | *'Name or service not'* | \
      *'Max retries exceeded'* | *'Read timed out'* | *ConnectTimeout* | *ProxyError* | *'Connection reset'*)
      fail "$1 failed: the package index cannot be reached." \
        "Check the network (and pip's proxy or index settings), then run it again; log: $log" ;;
    *CERTIFICATE_VERIFY_FAILED*)
      fail "$1 failed: the package index's certificate is not trusted here." \
        "Tell pip about your CA bundle (PIP_CERT=FILE), then run it again; log: $log" ;;
    *'No matching distribution found for'*)
      fail "$1 failed: $(grep -aoE 'No matching distribution found for .*' <<< "$tail" | tail -n 1)." \
        "The index that pip uses lacks it for this Python and machine; log: $log" ;;
    *'Permission denied'*)
      fail "$1 failed: $(grep -a 'Permission denied' <<< "$tail" | tail -n 1)" \
        "Make that writable, then run it again; log: $log" ;;
  esac
  printf 'setup: %s failed. The last lines of %s:\n' "$1" "$log" >&2
  grep -avE '^ *$|^-- (Up-to-date|Installing)|^WARNING: Location' <<< "$tail" | tail -n 12 |
    cut -c 1-300 | sed 's/^/       /' >&2
  exit 1
}
