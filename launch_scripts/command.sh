# SPDX-License-Identifier: Apache-2.0
# shellcheck shell=bash disable=SC2154
# Functions shared by train, land, evaluate and fly. Sourced after env.sh and attend.sh, not run.

file=$(dirname "$here")/ppo_agent_node/launch/${0##*/}.launch.yaml
# The lock marks the folder as in use. It is released when this script and its launch have ended, however they end.
# The next start removes the folders of killed scripts (rocket_sim_node/scratch_folder.py).
scratch=$(mktemp -d -t hoverslam-XXXXXX)
trap 'rm -rf "$scratch"' EXIT
exec {_lock}> "$scratch/lock"
flock "$_lock"

# read_arguments ARGUMENT...: checks the arguments. Sets `arguments`, those of the launch, and further variables that
# the command needs (ppo_agent_node/commands/launch.py). Exits after --help, and with status 2 after an error.
read_arguments() {
  python3 -m ppo_agent_node.commands.launch "$0" $$ "$scratch" "$@" || exit
  [[ -e $scratch/plan.sh ]] || exit 0
  . "$scratch/plan.sh"
}

# note_files FILE...: remembers the files as they are now, for is_new.
declare -A _noted
note_files() {
  local file
  for file; do _noted[$file]=$(stat -c '%i %z' -- "$file" 2> /dev/null) || true; done
}

# is_new FILE: whether the file exists and has been written since note_files. The modification time is not
# reliable: the clock may have been set back.
is_new() { [[ -e $1 && $(stat -c '%i %z' -- "$1" 2> /dev/null) != "${_noted[$1]}" ]]; }

# run_launch: runs the launch file of this command to its end, passes on signals, and sets `status`.
run_launch() {
  pass_on_signals INT TERM HUP
  attend ros2 launch "$file" "${arguments[@]}"
}

# recording_is_whole FILE: if the recorder left the file incomplete, prints how to repair it, and fails.
recording_is_whole() {
  local whole=$1 part=${1%.rrd}.partial.rrd
  # The recorder has repaired any partial file that existed before it started. An empty file has no flights.
  [[ -s $part && " ${arguments[*]} " != *' record:=false '* ]] || return 0
  [[ ! -e $whole ]] || whole=${1%.rrd}-repaired.rrd
  printf '%s: the recording is incomplete, because its recorder was killed or could not write; repair it with:\n' "${0##*/}"
  printf '  %q rrd merge --continue-on-error %q -o %q && rm %q\n' \
    "$(command -v rerun || echo rerun)" "$part" "$whole" "$part"
  return 1
} >&2

# finish: exits with the status of the command, or with that of the signal that stopped it.
finish() {
  case $status-$stopped in
    0-*) ;;
    *-INT) status=130 ;;
    *-TERM) status=143 ;;
  esac
  exit "$status"
}

# shown PATH: prints a path, quoted for a shell if it has characters that could control a terminal.
shown() {
  if [[ $1 == *[![:print:]]* ]]; then printf '%q' "$1"; else printf '%s' "$1"; fi
}

# tell_recording FILE: prints the path of the recording and a command that shows it, from any shell.
tell_recording() {
  printf 'recording: %s; watch it with: %q %q\n' "$(shown "$1")" "$(command -v rerun || echo rerun)" "$1"
}
