# SPDX-License-Identifier: Apache-2.0
# shellcheck shell=bash disable=SC2154
# What train, land, evaluate and fly have in common. Sourced after env.sh and attend.sh, not run.

file=$here/${0##*/}.launch.yaml
scratch=$(mktemp -d -t hoverslam-XXXXXX)
trap 'rm -rf "$scratch"' EXIT

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
  echo "recording: $1; watch it with: $(command -v rerun || echo rerun) $1"
}
