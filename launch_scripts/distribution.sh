# SPDX-License-Identifier: Apache-2.0
# shellcheck shell=bash
# Chooses the ROS 2 distribution, its virtual environment and its workspace. Sourced by ./setup and env.sh (bash or zsh).

# The distribution installed from wheels into .venv, unless HOVERSLAM_ROS names another one.
_hoverslam_default=kilted

# _hoverslam_choose ROOT: sets
#   _hoverslam_ros    the distribution
#   _hoverslam_mode   its origin: sourced:NAME, wheels (Kilted) or wheels:NAME
#   _hoverslam_venv   its virtual environment
#   _hoverslam_built  the folder with its build, install and log folders of the workspace
# Prints one line and fails with status 2 if HOVERSLAM_ROS does not name an available distribution.
_hoverslam_choose() {
  _hoverslam_ros=${HOVERSLAM_ROS:-$_hoverslam_default}
  _hoverslam_venv=$1/.venv
  _hoverslam_built=$1/ros_ws
  # In a shell of env.sh with ROS 2 from wheels, HOVERSLAM_WHEELS says that ROS_DISTRO is ours. A ROS 2 that is sourced
  # there later sets ROS_VERSION.
  if [ -n "${ROS_DISTRO:-}" ] && [ -n "${AMENT_PREFIX_PATH:-}" ] \
      && { [ "$ROS_DISTRO" != "${HOVERSLAM_WHEELS:-}" ] || [ -n "${ROS_VERSION:-}" ]; }; then
    if [ -n "${HOVERSLAM_ROS:-}" ] && [ "$HOVERSLAM_ROS" != "$ROS_DISTRO" ]; then
      echo "setup: HOVERSLAM_ROS is '$HOVERSLAM_ROS', expected '$ROS_DISTRO', which is sourced, or unset" >&2
      return 2
    fi
    _hoverslam_ros=$ROS_DISTRO
    _hoverslam_mode=sourced:$ROS_DISTRO
    return
  fi
  case $_hoverslam_ros in
    kilted | jazzy) ;;
    *)
      echo "setup: HOVERSLAM_ROS is '$_hoverslam_ros', expected kilted or jazzy, or a ROS 2 of that name that is sourced" >&2
      return 2 ;;
  esac
  # Environments that were made before there was a choice are marked with `wheels`; they are Kilted.
  if [ "$_hoverslam_ros" = kilted ]; then _hoverslam_mode=wheels; else _hoverslam_mode=wheels:$_hoverslam_ros; fi
  if [ "$_hoverslam_ros" != "$_hoverslam_default" ]; then
    _hoverslam_venv=$1/.venv-$_hoverslam_ros
    _hoverslam_built=$1/ros_ws/$_hoverslam_ros
  fi
}
