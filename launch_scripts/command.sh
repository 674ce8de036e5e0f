# SPDX-License-Identifier: Apache-2.0
# shellcheck shell=bash disable=SC2154
# What train, land, evaluate and fly have in common. Sourced after env.sh and attend.sh, not run.

file=$(dirname "$here")/ppo_agent_node/launch/${0##*/}.launch.yaml
# The lock says that the folder is in use: it goes with this script, and with its launch, however they end.
scratch=$(mktemp -d -t hoverslam-XXXXXX)
trap 'rm -rf "$scratch"' EXIT
exec {_lock}> "$scratch/lock"
flock "$_lock"

# remove_leftovers: removes the scratch folders of this user whose scripts were killed. One that has just been made
# may not be locked yet.
remove_leftovers() {
  local folder lock
  while IFS= read -r -d '' folder; do
    { exec {lock}< "$folder/lock"; } 2> /dev/null || continue
    if flock -n "$lock"; then rm -rf "$folder"; fi
    exec {lock}<&-
  done < <(find "$(dirname "$scratch")" -maxdepth 1 -type d -name 'hoverslam-*' -user "$(id -u)" -mmin +1 -print0)
}
remove_leftovers

# read_arguments ARGUMENT...: checks them and sets `arguments`, those of the launch, and what else this command
# needs (ppo_agent_node/commands/launch.py); exits after --help, and with status 2 after an error.
read_arguments() {
  python3 -m ppo_agent_node.commands.launch "$0" $$ "$scratch" "$@" || exit
  [[ -e $scratch/plan.sh ]] || exit 0
  . "$scratch/plan.sh"
}

# run_launch: runs the launch file of this command to its end and sets `status`; signals are passed on.
run_launch() {
  pass_on_signals INT TERM HUP
  attend ros2 launch "$file" "${arguments[@]}"
}

# recording_is_whole FILE: fails where a recorder of this start has left it unfinished, and says how to
# repair it.
recording_is_whole() {
  local whole=$1 part=${1%.rrd}.partial.rrd
  # One that was there before has been repaired by the recorder of this start; an empty one holds nothing.
  [[ -s $part && " ${arguments[*]} " != *' record:=false '* ]] || return 0
  [[ ! -e $whole ]] || whole=${1%.rrd}-repaired.rrd
  printf '%s: the recording is not finished, its recorder was killed or could not write; repair it with:\n' "${0##*/}"
  printf '  %q rrd merge --continue-on-error %q -o %q && rm %q\n' \
    "$(command -v rerun || echo rerun)" "$part" "$whole" "$part"
  return 1
} >&2

# finish: exits with the status of what was attended, or with that of the signal that stopped it.
finish() {
  case $status-$stopped in
    0-*) ;;
    *-INT) status=130 ;;
    *-TERM) status=143 ;;
  esac
  exit "$status"
}

# tell_recording FILE: says where it is and how to see it, from any shell.
tell_recording() {
  printf 'recording: %s; watch it with: %q %q\n' "$1" "$(command -v rerun || echo rerun)" "$1"
}
