# SPDX-License-Identifier: Apache-2.0
# shellcheck shell=bash disable=SC2154
# The steps of set-up: checks, .venv, the workspace and the environment file. Sourced by ./setup.

# check_machine: checks the requirements before anything is changed.
check_machine() {
  [[ $root != *[[:space:]:\&\#\'\"\\]* ]] ||
    fail "the path '$root' has a space, a colon, a quote, a backslash, & or #, which ROS 2 builds do not support." \
      'Move the project to a path without these characters.'
  [[ -w $root && -w $root/ros_ws && (! -e $venv || -w $venv) ]] ||
    fail "$root is not writable for $(id -un)." 'Copy the project to a folder of yours, or change its owner.'
  [[ $(uname -s) == Linux ]] || fail "this is $(uname -s); Hoverslam runs on Linux." 'Use a Linux machine, container or WSL 2.'
  if [[ $mode == wheels* ]]; then
    [[ $(uname -m) == x86_64 ]] ||
      fail "there are no ROS 2 wheels for $(uname -m), only for x86_64." \
        'Install ROS 2 Kilted or Jazzy for this machine, source its setup.bash, then run this again.'
    getconf GNU_LIBC_VERSION > /dev/null 2>&1 ||
      fail 'the ROS 2 wheels need glibc 2.28 or newer, which this system lacks (musl?).' \
        'Use Debian, Ubuntu, Fedora or the like, or install ROS 2 and source its setup.bash.'
  fi
  local tool
  for tool in cc:gcc c++:g++; do
    command -v "${tool%:*}" > /dev/null || command -v "${tool#*:}" > /dev/null ||
      fail "no ${tool#*:} found; a C and a C++ compiler build the ROS messages." \
        'Install them, on Debian and Ubuntu: sudo apt install build-essential'
  done
  if ! venv_ready && ! in_place; then
    local free
    free=$(df -Pk "$root" | awk 'NR == 2 {print int($4 / 1024)}')
    ((${free:-9999} >= 4000)) ||
      fail "only $free MB of disk are free in $root; about 4000 MB are needed." 'Free some space, then run it again.'
  fi
}

# take_lock: allows one set-up at a time. The lock is released when the last process that holds descriptor 9 ends.
take_lock() {
  exec 9> "$root/.setup.lock"
  flock -n 9 && return
  echo 'Waiting for another set-up of this folder to end ...' >&2
  flock 9
}

# note_users: names the processes that use the environment that will change. Processes whose files cannot be read
# are left out.
note_users() {
  local users
  users=$(grep -lsF -e "$venv/" -e "$built/" /proc/[0-9]*/maps | cut -d / -f 3 | tr '\n' ' ') || true
  [[ -z $users ]] ||
    echo "Note: processes that are running use what is replaced now, and may fail: ${users% }. A training can be resumed." >&2
}

# usable PYTHON: whether it runs and is CPython 3.11 to 3.13. With a sourced ROS 2, it must have rclpy and may be newer.
usable() {
  local newest='(3, 13)'
  [[ $mode == wheels* ]] || newest='(3, 99)'
  "$1" -c "
import sys
ok = sys.implementation.name == 'cpython' and (3, 11) <= sys.version_info[:2] <= $newest
sys.exit(0 if ok else 1)" > /dev/null 2>&1 || return 1
  [[ $mode == wheels* ]] || "$1" -c 'import rclpy' > /dev/null 2>&1
}

# find_python: sets $python.
find_python() {
  local candidate versions='3.11, 3.12 or 3.13' example=python3.12
  [[ $mode == wheels* ]] || versions='3.11 or newer' example=python3
  if [[ -n ${PYTHON:-} ]]; then
    usable "$PYTHON" || fail "PYTHON=$PYTHON is not a CPython $versions that runs$wanted." \
      'Name another one, or unset PYTHON.'
    python=$(command -v "$PYTHON")
    [[ $python != "$venv"/* ]] || fail "PYTHON=$PYTHON is inside .venv, which set-up is about to replace." \
      'Name another one, or unset PYTHON.'
    return
  fi
  for candidate in python3.11 python3.12 python3.13 python3; do
    if usable "$candidate"; then python=$(command -v "$candidate"); return; fi
  done
  fail "no CPython $versions found$wanted." \
    'Install one, on Debian and Ubuntu: sudo apt install python3 python3-venv python3-dev' \
    "or name one: PYTHON=/path/to/$example ./launch_scripts/setup"
}

# requirements FILE: writes the pinned versions that this mode needs to the file. NumPy is pinned even with a sourced
# ROS 2: rerun-sdk needs NumPy 2, and messages that were compiled for an older NumPy work with it.
requirements() {
  if [[ $mode == wheels* ]]; then section ros > "$1"; else : > "$1"; fi
  if [[ $mode == wheels* ]] || ! "$python" -c 'import colcon_core, colcon_ros' 2> /dev/null; then
    section colcon >> "$1"
  fi
  section run >> "$1"
  section test >> "$1"
}

# venv_was: prints the state of .venv, or its state before a failed update; nothing if it is unknown.
venv_was() {
  local was
  was=$(cat "$stamps/venv" 2> /dev/null) || return 0
  printf '%s' "${was#unfinished }"
}

# in_place: whether only the pinned versions have changed, so that .venv can be updated in place.
in_place() {
  local was kept
  was=$(venv_was)
  kept=$(venv_state)
  [[ -n $was && ${was% *} == "${kept% *}" ]] && same_python && "$venv/bin/python" -c '' 2> /dev/null
}

# pip_install TEXT ARGUMENT...: one step of make_venv. If pip fails, it restores what it could not update, so the
# update can be tried again in place. If pip is killed, the state of .venv is unknown.
pip_install() {
  local text=$1
  shift
  step "$text" "${pip[@]}" install --retries 8 --timeout 60 "$@" || {
    [[ -z $old ]] || printf 'unfinished %s' "$old" > "$stamps/venv"
    explain 'Installing packages'
  }
}

# make_venv: makes .venv with all packages. Starts from an empty one, unless only the pinned versions have changed.
make_venv() {
  local wanted='' python='' old='' pip kept
  [[ $mode == wheels* ]] || wanted=" whose rclpy is that of the sourced ROS 2 ${ROS_DISTRO:-}"
  kept=$(venv_state)
  if in_place; then
    python=$(< "$stamps/python")
    old=$(venv_was)
    rm -f "$stamps/venv"
  else
    find_python
    new_venv
  fi
  pip=("$venv/bin/python" -m pip --disable-pip-version-check --no-input)
  requirements "$stamps/requirements"
  section build > "$stamps/build"
  pip_install 'Preparing pip' -r "$stamps/build"
  pip_install 'Installing ROS 2 and libraries' --progress-bar off --no-build-isolation -r "$stamps/requirements"
  if [[ $mode == wheels* ]]; then
    step 'Checking packages' "${pip[@]}" check || explain 'Checking packages'
    relocate
    install_ros2
  fi
  printf '%s' "$python" > "$stamps/python"
  printf '%s %s %s %s' "$root" "$python" "$("$venv/bin/python" -VV | digest)" "$(section ros | digest)" > "$stamps/id"
  printf '%s' "$kept" > "$stamps/venv"
}

# new_venv: makes an empty .venv with $python.
new_venv() {
  local options=()
  [[ $mode == wheels* ]] || options=(--system-site-packages)
  [[ -f $("$python" -c 'import sysconfig; print(sysconfig.get_path("include"))')/Python.h ]] ||
    fail "the headers (Python.h) of $python are missing; the ROS messages are built with them." \
      "Install them, on Debian and Ubuntu: sudo apt install $("$python" -c 'import sys; print("python%d.%d-dev" % sys.version_info[:2])')"
  rm -rf "$venv"
  step "Making $(basename "$venv") with $("$python" -V 2>&1)" "$python" -m venv "${options[@]}" "$venv" || {
    rm -rf "$venv"
    case $(tail -n 20 "$log") in
      *ensurepip* | *'No module named venv'*)
        fail "$python has no working venv module." \
          "Install it, on Debian and Ubuntu: sudo apt install $("$python" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')" ;;
      *) explain 'Making .venv' ;;
    esac
  }
  mkdir -p "$stamps"
  printf '%s' "$python" > "$stamps/python"
}

# relocate: corrects the CMake files of the wheels, which contain include paths of the machine that built them.
relocate() {
  local python_include numpy_include stale
  python_include=$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("include"))')
  numpy_include=$("$venv/bin/python" -c 'import numpy; print(numpy.get_include())')
  stale='/opt/python/cp[0-9]+-cp[0-9]+'
  { grep -rslE "$stale" "$venv"/share/*/cmake || true; } | xargs -r sed -i -E \
    -e "s#$stale/include/python[0-9.]+#$python_include#g" \
    -e "s#$stale/lib/python[0-9.]+/site-packages/numpy/_?core/include#$numpy_include#g"
}

# install_ros2: installs the replacement for the ros2 command, which the wheels lack.
install_ros2() {
  cat > "$venv/bin/ros2" << END
#!$venv/bin/python
"""The ros2 command of launch_scripts/ros2, for an environment of wheels."""
import sys

sys.path.insert(0, '$here')
from ros2.main import main

sys.exit(main())
END
  chmod +x "$venv/bin/ros2"
}

# colcon_build TEXT ARGUMENT...: runs one build, with the tools of .venv only.
colcon_build() {
  local text=$1
  shift
  if [[ $mode == wheels* ]]; then export AMENT_PREFIX_PATH=$venv CMAKE_PREFIX_PATH=$venv; fi
  export VIRTUAL_ENV=$venv PATH=$venv/bin:$PATH COLCON_LOG_LEVEL=error COLCON_EXTENSION_BLOCKLIST=colcon_core.event_handler.desktop_notification
  cd "$root/ros_ws" || fail "$root/ros_ws is missing."
  mkdir -p "$built"
  step "$text" "$venv/bin/python" -m colcon --log-base "$built/log" build \
    --build-base "$built/build" --install-base "$install" --event-handlers console_direct+ console_start_end- "$@" || explain "$text"
  cd "$root" || exit
}

# vendored: prints the packages of ros_ws/vendor that the ROS 2 in use lacks; the wheels lack all of them.
vendored() {
  local package prefix prefixes=()
  [[ $mode == wheels* ]] || IFS=: read -r -a prefixes <<< "${AMENT_PREFIX_PATH:-}"
  for package in "$root"/ros_ws/vendor/*/package.xml; do
    package=$(basename "${package%/package.xml}")
    for prefix in "${prefixes[@]}"; do
      if [[ $prefix != "$root"/* && -f $prefix/share/$package/package.xml ]]; then continue 2; fi
    done
    echo "$package"
  done
}

# build_messages: builds rocket_msgs and the vendored packages, from scratch unless only their sources have changed.
# The vendored packages are copied first, because colcon ignores their own folder. That folder is ignored so that they
# never hide the packages of a full ROS 2.
build_messages() {
  local old
  old=$(cat "$install/.messages" 2> /dev/null) || old=
  rm -f "$install/.messages"
  [[ ${old% *} == "1 $(< "$stamps/id")" ]] || rm -rf "$built"/{build,install,log}
  local state package packages=(rocket_msgs) generator=() copies=$built/build/vendor
  state=$(messages_state)
  rm -rf "$copies"
  mkdir -p "$copies"
  for package in $(vendored); do
    cp -r "$root/ros_ws/vendor/$package" "$copies"
    packages+=("$package")
  done
  [[ ! -x $venv/bin/ninja ]] || generator=(-GNinja)
  colcon_build 'Building messages' --base-paths src "$copies" --packages-select "${packages[@]}" \
    --cmake-args "${generator[@]}" -DBUILD_TESTING=OFF "-DPython3_EXECUTABLE=$venv/bin/python"
  printf '%s' "$state" > "$install/.messages"
}

# build_nodes: installs the Python packages as links to their sources, so that edits need no build.
build_nodes() {
  local state
  rm -rf "$install/.nodes" "$built"/{build,install}/{rocket_sim_node,ppo_agent_node}
  state=$(nodes_state)
  colcon_build 'Linking the nodes' --symlink-install --packages-select rocket_sim_node ppo_agent_node
  printf '%s' "$state" > "$install/.nodes"
}

# write_environment: stores the variables that the workspace's own set-up file exports, for env.sh to set.
write_environment() {
  local name value part parts i file=$stamps/env.sh
  echo '# Written by launch_scripts/setup; read by launch_scripts/env.sh.' > "$file.new"
  while IFS='=' read -r -d '' name value; do
    case $name in *PATH) ;; *) continue ;; esac
    IFS=: read -r -a parts <<< "$value"
    for ((i = ${#parts[@]} - 1; i >= 0; i--)); do
      part=${parts[i]}
      case $part in "$root"/*) printf '_hoverslam_prepend %s %q\n' "$name" "$part" >> "$file.new" ;; esac
    done
  done < <(env -i HOME="${HOME:-/}" PATH=/usr/bin:/bin bash --norc -c ". '$install/local_setup.bash' && env -0" 2>> "$log")
  grep -q rocket_msgs "$file.new" || explain "Reading $install/local_setup.bash"
  mv "$file.new" "$file"
}
