# SPDX-License-Identifier: Apache-2.0
# shellcheck shell=bash
# Activates the environment in a shell: . launch_scripts/env.sh (bash or zsh). First sets up what is
# missing. Sourcing it again changes nothing. Returns the status of set-up if that fails.

if [ -n "${ZSH_VERSION:-}" ]; then eval '_hoverslam_here=${(%):-%x}'; else _hoverslam_here=${BASH_SOURCE[0]:-}; fi
_hoverslam_here=$(CDPATH= cd "$(dirname "$_hoverslam_here")" && pwd -P) || return 1

# _hoverslam_prepend NAME FOLDER: moves the folder to the front of a list such as PATH. Removes empty entries, which
# stand for the current folder.
_hoverslam_prepend() {
  eval "_hoverslam_list=:\${$1:-}:"
  while :; do
    case $_hoverslam_list in
      *::*) _hoverslam_list=${_hoverslam_list%%::*}:${_hoverslam_list#*::} ;;
      *":$2:"*) _hoverslam_list=${_hoverslam_list%%":$2:"*}:${_hoverslam_list#*":$2:"} ;;
      *) break ;;
    esac
  done
  _hoverslam_list=${_hoverslam_list#:}
  _hoverslam_list=${_hoverslam_list%:}
  eval "export $1=\$2\${_hoverslam_list:+:\$_hoverslam_list}"
}

# _hoverslam_drop NAME PREFIX: removes entries that begin with PREFIX from a list such as PATH.
_hoverslam_drop() {
  eval "_hoverslam_list=:\${$1:-}:"
  while :; do
    case $_hoverslam_list in
      *":$2"*)
        _hoverslam_rest=${_hoverslam_list#*":$2"}
        _hoverslam_list=${_hoverslam_list%%":$2"*}:${_hoverslam_rest#*:} ;;
      *) break ;;
    esac
  done
  _hoverslam_list=${_hoverslam_list#:}
  _hoverslam_list=${_hoverslam_list%:}
  if [ -n "$_hoverslam_list" ]; then eval "export $1=\$_hoverslam_list"; else unset "$1"; fi
}

# _hoverslam_command: settings for the commands in this folder only, not for an interactive shell.
_hoverslam_command() {
  # They import nothing from the folder in which they are called. In an interactive shell, Python finds modules beside
  # your programs as usual.
  export PYTHONSAFEPATH=1
  . "$_hoverslam_here/streams.sh"
}

_hoverslam_enter() {
  # If HOME is not set, set it to the user's home folder, where ROS 2 keeps its logs.
  if [ -z "${HOME:-}" ]; then unset HOME; HOME=~; export HOME; fi
  if [ "$0" -ef "$_hoverslam_here/${0##*/}" ]; then _hoverslam_command; fi
  "$_hoverslam_here/setup" --quiet || return
  . "$_hoverslam_here/distribution.sh"
  _hoverslam_root=${_hoverslam_here%/*}
  _hoverslam_choose "$_hoverslam_root" || return
  # A shell may have been in the environment of another distribution.
  for _hoverslam_name in PATH AMENT_PREFIX_PATH CMAKE_PREFIX_PATH LD_LIBRARY_PATH; do
    _hoverslam_drop "$_hoverslam_name" "$_hoverslam_root/.venv"
    _hoverslam_drop "$_hoverslam_name" "$_hoverslam_root/ros_ws/"
  done
  unset PYTHONHOME _ROS_WHEELS_BOOTSTRAP_COMPLETE
  . "$_hoverslam_venv/bin/activate" || return 1
  _hoverslam_prepend PATH "$_hoverslam_venv/bin"
  if [ "${_hoverslam_mode%%:*}" = sourced ]; then
    unset HOVERSLAM_WHEELS
    for _hoverslam_list in "$_hoverslam_venv"/lib/python3.*/site-packages; do
      _hoverslam_prepend PYTHONPATH "$_hoverslam_list"
    done
  else
    # Packages of another Python would not work here and could hide ours.
    unset PYTHONPATH ROS_VERSION ROS_PYTHON_VERSION
    # Tools such as `ros2 doctor` and bags need the name; the second variable keeps it from counting
    # as sourced.
    export ROS_DISTRO="$_hoverslam_ros" HOVERSLAM_WHEELS="$_hoverslam_ros"
    _hoverslam_prepend AMENT_PREFIX_PATH "$_hoverslam_venv"
    _hoverslam_prepend CMAKE_PREFIX_PATH "$_hoverslam_venv"
    export RMW_IMPLEMENTATION=rmw_fastrtps_cpp
  fi
  . "$_hoverslam_venv/.hoverslam/env.sh" || return 1
  export ROS_AUTOMATIC_DISCOVERY_RANGE="${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}"
}

if _hoverslam_enter; then _hoverslam_status=0; else _hoverslam_status=$?; fi
unset -f _hoverslam_choose _hoverslam_command _hoverslam_drop _hoverslam_enter _hoverslam_prepend 2> /dev/null || true
unset _hoverslam_here _hoverslam_root _hoverslam_default _hoverslam_ros _hoverslam_mode _hoverslam_venv _hoverslam_built \
  _hoverslam_list _hoverslam_rest _hoverslam_name
eval "unset _hoverslam_status; return $_hoverslam_status"
