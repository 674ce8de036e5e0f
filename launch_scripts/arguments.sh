# SPDX-License-Identifier: Apache-2.0
# shellcheck shell=bash
# Arguments of the form NAME:=VALUE for the scripts beside this file. Sourced, not run.

die() {
  printf '%s: %s\n' "${0##*/}" "$1" >&2
  exit 2
}

# launch_arguments FILE: names of the arguments that a launch file declares.
launch_arguments() {
  sed -n 's/^- arg: {name: \([a-z_]*\)[,}].*/\1/p' "$1"
}

# usage FILE TEXT: what a script does and which arguments it takes.
usage() {
  printf 'Usage: %s [NAME:=VALUE ...]\n\n%s\n\nArguments:\n' "$0" "$2"
  sed -n -e '/^- arg: {/{' -e ':a' -e '/}$/!{N;ba' -e '}' -e 's/\n */ /g' \
    -e "s/^- arg: {name: \([a-z_]*\),* *\(default: '*\([^,']*\)'*,\)* *description: '\(.*\)'}/\1\t\4\t\3/p" \
    -e '}' "$1" | awk -F '\t' '{printf "  %-22s %s%s\n", $1, $2, ($3 == "" ? "" : " [" $3 "]")}'
}

# parse_arguments FILE ARGUMENT...: sets the arrays `values` (by name), `known` (those that the
# launch file declares) and `others` (those that it does not). Values are not looked at here.
declare -A values=()
known=()
others=()
parse_arguments() {
  local file=$1 argument value
  shift
  for argument in "$@"; do
    [[ $argument =~ ^([a-z_][a-z0-9_]*):=(.*)$ ]] ||
      die "got '$argument', expected NAME:=VALUE, for example seed:=3 (see --help)"
    value=${BASH_REMATCH[2]}
    case $value in True | TRUE | False | FALSE) value=${value,,} ;; esac
    values[${BASH_REMATCH[1]}]=$value
  done
  if [[ ${values[namespace]:-/} != /* ]]; then values[namespace]=/${values[namespace]}; fi
  local name declared
  declared=" $(launch_arguments "$file" | tr '\n' ' ') "
  for name in "${!values[@]}"; do
    if [[ $declared == *" $name "* ]]; then known+=("$name"); else others+=("$name"); fi
  done
}

# one_of NAME CHOICE...: ends with an error when an argument is given as none of these.
one_of() {
  local name=$1 choice
  shift
  [[ -n ${values[$name]:-} ]] || return 0
  for choice; do
    [[ $choice != "${values[$name]}" ]] || return 0
  done
  local expected
  printf -v expected ', %s' "$@"
  die "$name: got '${values[$name]}', expected one of ${expected:2}"
}

# check_names CONDITION...: ends with an error for a world or conditions that there are not, before
# nodes are started that would say so among others. More conditions than all know may be given.
check_names() {
  one_of world rocket rocket_planar lunar_lander
  one_of conditions nominal mix harsh hoverslam "$@"
  if [[ ${values[world]:-rocket} != rocket* && ${values[conditions]:-nominal} != nominal ]]; then
    die "conditions: got '${values[conditions]}', expected none, as world '${values[world]}' has no conditions"
  fi
}

# absolute NAME: makes the path in an argument absolute, so that it means the same to every node.
# The shell leaves a ~ behind := as it is.
absolute() {
  # shellcheck disable=SC2088 # the letter is meant
  if [[ ${values[$1]:-} == '~/'* ]]; then values[$1]=$HOME/${values[$1]#'~/'}; fi
  if [[ -n ${values[$1]:-} && ${values[$1]} != /* ]]; then values[$1]=$PWD/${values[$1]}; fi
}

# absolute_policy NAME: as `absolute`, but a word that is no file here and has neither dot nor slash
# stands for a policy that ships, and stays as it is.
absolute_policy() {
  if [[ ${values[$1]:-} == *[./]* || -f ${values[$1]:-} ]]; then absolute "$1"; fi
}

# absolute_pilots NAME: the same for several, with commas between.
absolute_pilots() {
  local given=${values[$1]:-} name all=
  while [[ -n $given ]]; do
    name=${given%%,*}
    given=${given#"$name"}
    given=${given#,}
    values[$1]=$name
    absolute_policy "$1"
    all+=${all:+,}${values[$1]}
  done
  if [[ -n $all ]]; then values[$1]=$all; fi
}

# see_extended: lets rockets be seen with the extended observation unless another is asked for; pilots
# take from it what they know.
see_extended() {
  if [[ -z ${values[observation]:-} && ${values[world]:-rocket} == rocket* ]]; then
    values[observation]=extended
    known+=(observation)
  fi
}

# new_folder PATH: makes a folder of this name, of PATH-2, PATH-3 … where there is one already (two
# in one second, or a clock that was set back), and prints its name.
new_folder() {
  local path=$1 number=1
  mkdir -p "$(dirname "$1")"
  until mkdir "$path" 2> /dev/null; do
    [[ -e $path ]] || die "$path: cannot be made"
    path=$1-$((++number))
  done
  printf '%s\n' "$path"
}

# own_namespace NAME: keeps the nodes apart from those of a training that runs meanwhile.
own_namespace() {
  if [[ -z ${values[namespace]+given} ]]; then
    values[namespace]=/$1_$$
    known+=(namespace)
  fi
}

# refuse_others FILE: ends with an error when there are arguments that the launch file lacks.
refuse_others() {
  ((${#others[@]} == 0)) ||
    die "unknown argument '${others[0]}', expected one of $(launch_arguments "$1" | paste -sd ' ')"
}

# known_arguments: prints the declared arguments again, one a line; not those given as nothing, which
# means the default.
known_arguments() {
  local name
  for name in "${known[@]}"; do
    [[ -z ${values[$name]} ]] || printf '%s:=%s\n' "$name" "${values[$name]}"
  done
}

# yaml_value TEXT: prints a value for a file of parameters: as it is, so that a number stays one, or
# quoted where YAML would take it for something else, or for nothing.
yaml_value() {
  case $1 in
    '' | *': '* | *' #'* | *: | [\!\&\*\{%@\`\|\>\?\#,\]]* | '- '*) printf "'%s'" "${1//\'/\'\'}" ;;
    *) printf '%s' "$1" ;;
  esac
}

# tell_recording FILE: says where it is and how to see it, from any shell.
tell_recording() {
  echo "recording: $1; watch it with: $(command -v rerun || echo rerun) $1"
}
