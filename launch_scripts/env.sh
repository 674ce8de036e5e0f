# SPDX-License-Identifier: Apache-2.0
# shellcheck shell=bash
# Puts a shell inside the environment: . launch_scripts/env.sh (bash or zsh). It sets up what is
# missing first; sourcing it again changes nothing. Returns non-zero when set-up failed.

if [ -n "${ZSH_VERSION:-}" ]; then eval '_hoverslam_here=${(%):-%x}'; else _hoverslam_here=${BASH_SOURCE[0]:-}; fi
_hoverslam_here=$(CDPATH= cd "$(dirname "$_hoverslam_here")" && pwd -P) || return 1

# _hoverslam_prepend NAME FOLDER: puts it first in a list such as PATH, once.
_hoverslam_prepend() {
  eval "_hoverslam_list=:\${$1:-}:"
  while :; do
    case $_hoverslam_list in
      *":$2:"*) _hoverslam_list=${_hoverslam_list%%":$2:"*}:${_hoverslam_list#*":$2:"} ;;
      *) break ;;
    esac
  done
  _hoverslam_list=${_hoverslam_list#:}
  _hoverslam_list=${_hoverslam_list%:}
  eval "export $1=\$2\${_hoverslam_list:+:\$_hoverslam_list}"
}

_hoverslam_enter() {
  "$_hoverslam_here/setup" --quiet || return 1
  _hoverslam_venv=${_hoverslam_here%/*}/.venv
  unset PYTHONHOME _ROS_WHEELS_BOOTSTRAP_COMPLETE
  . "$_hoverslam_venv/bin/activate" || return 1
  _hoverslam_prepend PATH "$_hoverslam_venv/bin"
  if [ -n "${ROS_DISTRO:-}" ] && [ -n "${AMENT_PREFIX_PATH:-}" ]; then
    for _hoverslam_list in "$_hoverslam_venv"/lib/python3.*/site-packages; do
      _hoverslam_prepend PYTHONPATH "$_hoverslam_list"
    done
  else
    # Packages of another Python are of no use here, and could hide ours; and a distribution that
    # is named but not sourced would count as sourced from now on.
    unset PYTHONPATH ROS_DISTRO
    _hoverslam_prepend AMENT_PREFIX_PATH "$_hoverslam_venv"
    _hoverslam_prepend CMAKE_PREFIX_PATH "$_hoverslam_venv"
    export RMW_IMPLEMENTATION=rmw_fastrtps_cpp
  fi
  . "$_hoverslam_venv/.hoverslam/env.sh" || return 1
  export ROS_AUTOMATIC_DISCOVERY_RANGE="${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}"
}

if _hoverslam_enter; then
  unset -f _hoverslam_enter _hoverslam_prepend
  unset _hoverslam_here _hoverslam_venv _hoverslam_list
else
  unset -f _hoverslam_enter _hoverslam_prepend
  unset _hoverslam_here _hoverslam_venv _hoverslam_list
  return 1
fi
