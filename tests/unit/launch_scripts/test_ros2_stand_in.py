# SPDX-License-Identifier: Apache-2.0
"""The replacement for the ros2 command: launch files, substitutions, processes, messages."""
from __future__ import annotations

import array
import asyncio
import os
import resource
import signal
import subprocess
import sys
import time
from contextlib import nullcontext
from pathlib import Path

import pytest
import yaml
import zstandard
from mcap.records import Channel
from mcap.records import Chunk
from mcap.records import Schema

from ros2.commands import bag
from ros2.errors import CommandError
from ros2.launch.actions import ProcessPlan
from ros2.launch.actions import carry_out
from ros2.launch.context import Context
from ros2.launch.context import LaunchError
from ros2.launch.context import join_namespaces
from ros2.launch.context import parse_arguments
from ros2.launch.log import Log
from ros2.launch.process import Process
from ros2.launch.substitutions import substitute
from ros2.main import main

_SCRIPTS = Path(__file__).parents[3] / 'launch_scripts'


@pytest.fixture
def context(tmp_path: Path) -> Context:
    return Context({'n': '3', 'name': 'a b', 'yes': 'True'}, tmp_path / 'log',
                   tmp_path / 'x.launch.yaml')


@pytest.fixture
def index(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An install prefix with the package `dummies`."""
    prefix = tmp_path / 'install'
    (prefix / 'share/ament_index/resource_index/packages').mkdir(parents=True)
    (prefix / 'share/ament_index/resource_index/packages/dummies').touch()
    (prefix / 'share/dummies').mkdir()
    folder = prefix / 'lib/dummies'
    folder.mkdir(parents=True)
    (folder / 'talker').write_text('#!/bin/sh\necho "$@"\nexit 7\n')
    (folder / 'talker').chmod(0o755)
    (folder / 'notes.txt').touch()
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(prefix))
    return prefix


def plan_of(text: str, context: Context) -> list[ProcessPlan]:
    context.file.write_text(text)
    return carry_out(context.file, context)


def parameters_of(plan: ProcessPlan) -> dict[str, object]:
    """All parameters of the files on a command line, the later winning."""
    result: dict[str, object] = {}
    for flag, path in zip(plan.command, plan.command[1:], strict=False):
        if flag == '--params-file':
            (_, node), = yaml.safe_load(Path(path).read_text()).items()
            result.update(node['ros__parameters'])
    return result


@pytest.mark.parametrize(('text', 'expected'), [
    ('plain', 'plain'),
    ('a$(var n)b', 'a3b'),
    ('$(var $(var which))', '3'),
    ("$(var '$(var which)')", '3'),
    (r'\$(var n)', '$(var n)'),
    ('costs $5', 'costs $5'),
    ("$(eval \"'one' if '$(var name)' else 'two'\")", 'one'),
    ("$(eval \"'one' if '' else '$(var n)'\")", '3'),
    ("$(eval \"'a' if '' else 'b' if '$(var n)' in ('2', '3') else 'c'\")", 'b'),
    ("$(eval \"'a' if '$(var n)' in ('2', '4') else 'c'\")", 'c'),
])
def test_substitutions(text: str, expected: str, context: Context) -> None:
    context.arguments['which'] = 'n'
    assert substitute(text, context) == expected


@pytest.mark.parametrize(('text', 'message'), [
    ('$(var missing)', "launch configuration 'missing' does not exist"),
    ('$(env HOME)', r'substitution \$\(env\) is not supported here, only \$\(dirname\), '
                    r'\$\(eval\), \$\(var\); a full ROS 2 supports more'),
    ('$(find-pkg-share x)', r'substitution \$\(find-pkg-share\) is not supported here'),
    ('$(var missing default)', r'\$\(var\) with 2 arguments is not supported here, only with 1; '),
    ('$(var)', 'with 0 arguments'),
    ('$(var n', 'not a substitution of the form'),
    ("$(var 'n)", 'quote is not closed'),
    ('$(eval "1 + 1")', r"\$\(eval\) of '1 \+ 1' is not supported here, only 'A' if 'B' else 'C'"),
    ('$(eval "\'a\' == \'b\'")', 'a full ROS 2 supports more'),
    ('$(eval "\'a\' if 1 else \'b\'")', 'each a text; a full ROS 2 supports more'),
    ('$(eval "open(1)")', 'is not supported here'),
    ('$(eval "\'a\' if \'it\'s\' else \'b\'")', 'fails: '),
])
def test_wrong_substitutions_are_refused_with_a_reason(
        text: str, message: str, context: Context) -> None:
    with pytest.raises(LaunchError, match=message):
        substitute(text, context)


def test_dirname_is_that_of_the_launch_file(context: Context) -> None:
    plan_of('launch:\n- arg: {name: here, default: $(dirname)/x}\n', context)
    assert context.arguments['here'] == str(context.file.parent / 'x')


def test_substituted_values_are_typed_by_yaml_and_plain_ones_keep_their_type(
        context: Context, index: Path) -> None:
    context.arguments.update(
        {'f': '1.0', 's': 'abc', 't': 'true', 'empty': ''})
    plan, = plan_of("""
launch:
- node:
    pkg: dummies
    exec: talker
    name: t
    param:
    - {name: int, value: $(var n)}
    - {name: float, value: $(var f)}
    - {name: string, value: $(var s)}
    - {name: bool, value: $(var t)}
    - {name: empty, value: $(var empty)}
    - {name: path, value: $(var s)/$(var n)}
    - {name: plain_int, value: 1}
    - {name: plain_float, value: 1.0}
    - {name: plain_string, value: '1'}
    - {name: forced, value: $(var n), type: str}
    - {name: forced_float, value: $(var n), type: float}
""", context)
    values = parameters_of(plan)
    expected = {
        'int': 3, 'float': 1.0, 'string': 'abc', 'bool': True, 'empty': '',
        'path': 'abc/3', 'plain_int': 1, 'plain_float': 1.0, 'plain_string': '1',
        'forced': '3', 'forced_float': 3.0}
    assert values == expected
    assert {k: type(v) for k, v in values.items()} == {k: type(v) for k, v in expected.items()}


def test_parameter_files_keep_their_place_between_values(context: Context, index: Path) -> None:
    file = context.file.parent / 'p.yaml'
    file.write_text('/**: {ros__parameters: {a: 2, b: 2}}')
    plan, = plan_of(f"""
launch:
- node:
    pkg: dummies
    exec: talker
    name: t
    param:
    - {{name: a, value: 1}}
    - {{from: {file}}}
    - {{name: b, value: 3}}
""", context)
    assert parameters_of(plan) == {'a': 2, 'b': 3}


def test_a_node_becomes_a_command_line(context: Context, index: Path) -> None:
    first, second = plan_of("""
launch:
- group:
  - push_ros_namespace: {namespace: fleet}
  - push_ros_namespace: {namespace: one}
  - arg: {name: n, default: not used}
  - arg: {name: inner, default: '4'}
  - node:
      pkg: dummies
      exec: talker
      name: t$(var n)$(var inner)
      output: screen
      on_exit: shutdown
      sigterm_timeout: 30.0
- node: {pkg: dummies, exec: talker, name: $(var name), respawn: true, respawn_delay: 1.5}
""", context)
    path = str(index / 'lib/dummies/talker')
    assert first == ProcessPlan(
        'talker-1', (path, '--ros-args', '-r', '__node:=t34', '-r', '__ns:=/fleet/one'),
        'screen', True, 30.0)
    assert second == ProcessPlan(
        'talker-2', (path, '--ros-args', '-r', '__node:=a b'), respawn_delay=1.5)
    assert 'inner' not in context.arguments


@pytest.mark.parametrize(('condition', 'started'), [
    ('$(var yes)', True), ('1', True), ('FALSE', False), ('0', False)])
def test_a_condition_decides_whether_a_node_starts(
        condition: str, started: bool, context: Context, index: Path) -> None:
    plans = plan_of(f"""
launch:
- node: {{pkg: dummies, exec: talker, name: t, if: {condition!r}}}
""", context)
    assert bool(plans) == started


def node(attributes: str) -> str:
    return f'{{node: {{pkg: dummies, exec: talker, name: t, {attributes}}}}}'


@pytest.mark.parametrize(('entry', 'message'), [
    ('{include: {file: x}}', "entity 'include' is not supported here, only arg, group, node, "
     'push_ros_namespace; a full ROS 2 supports more'),
    ('{executable: {cmd: ls}}', "entity 'executable' is not supported here"),
    ('{push-ros-namespace: {namespace: x}}', "entity 'push-ros-namespace' is not supported here"),
    ('{group: {scoped: false, children: []}}', 'a group with attributes is not supported here'),
    (node('respawn_max_retries: 3'), r"node 'talker': attribute 'respawn_max_retries' is not "
     r'supported here, only exec, if, name, .*, sigterm_timeout; a full ROS 2 supports more'),
    (node('unless: x'), "attribute 'unless' is not supported here"),
    (node('remap: [{from: a, to: b}]'), "attribute 'remap' is not supported here"),
    ('{arg: {name: a, default: b, choice: [{value: b}]}}',
     "attribute 'choice' is not supported here"),
    ('{arg: {name: a, default: $(env HOME)}}',
     r"arg 'a': substitution \$\(env\) is not supported"),
    (node('param: [{name: a, param: []}]'), "attribute 'param' of a param is not supported here"),
    (node('param: [{name: a, value: 1, type: list_of_ints}]'), "type 'list_of_ints' of parameter"
     " 'a' is not supported here, only str, int, float, bool; a full"),
    (node('param: [{from: x, allow_substs: true}]'), "'from' must be the only key of a param"),
    (node('param: [{name: a, value: [1, 2]}]'), r'parameter value \[1, 2\] is not supported here'),
    (node('output: both'), "output 'both' is not supported here, only screen, log; a full ROS 2"),
    (node('on_exit: restart'), "on_exit 'restart' is not supported here, only shutdown; a full"),
])
def test_launch_features_of_a_full_ros_2_are_refused_by_name(
        entry: str, message: str, context: Context, index: Path) -> None:
    with pytest.raises(LaunchError, match=message) as caught:
        plan_of(f'launch:\n- {entry}\n', context)
    text = str(caught.value)
    assert text.startswith(f'{context.file}: ') and text.endswith('a full ROS 2 supports more')
    assert '\n' not in text


@pytest.mark.parametrize(('entry', 'message'), [
    ('{arg: {name: a, default: 3}}', "arg 'a': 'default' must be a text, got 3"),
    ('{arg: {name: a}}', 'Required launch argument "a"'),
    ('{arg: [a]}', r"arg: expected attributes and values, got \['a'\]"),
    ('{node: {pkg: dummies, exec: talker}}', "node 'talker': 'name' is missing"),
    ('{node: {pkg: dummies, exec: x}}', "executable 'x' not found on the libexec directory"),
    ('{node: {pkg: nope, exec: x}}', "Package 'nope' not found"),
    (node('param: [{name: a, value: null}]'), 'results in None'),
    (node('param: [{value: 1}]'), "each param needs 'name' and 'value'"),
    (node('param: [{name: a, value: x, type: int}]'), "results in 'x', which is not int"),
    (node('param: [{from: /nope}]'), "parameter file '/nope'"),
    (node('if: maybe'), "condition 'maybe' is neither true nor false"),
    (node('sigterm_timeout: -1'), "'sigterm_timeout' must be a number"),
    (node('respawn: 3'), "'respawn' must be true or false, got 3"),
    (node('respawn: true, respawn_delay: soon'), "'respawn_delay' must be a number"),
])
def test_errors_name_the_file_and_the_entity(
        entry: str, message: str, context: Context, index: Path) -> None:
    with pytest.raises(LaunchError, match=message) as caught:
        plan_of(f'launch:\n- {entry}\n', context)
    assert str(caught.value).startswith(str(context.file))


@pytest.mark.parametrize(('text', 'message'), [
    ('launch: [', 'not valid YAML'), ('nodes: []', "expected 'launch' as root tag"),
    ('launch: {}', 'expected a list of entities'), ('launch: [a]', 'entity 1 must have one key'),
])
def test_invalid_launch_files_are_refused(text: str, message: str, context: Context) -> None:
    with pytest.raises(LaunchError, match=message):
        plan_of(text, context)


@pytest.mark.parametrize(('base', 'own', 'expected'), [
    ('', '', ''), ('', 'a', '/a'), ('/a', '', '/a'), ('/a', 'b', '/a/b'), ('/a', '/b', '/b')])
def test_namespaces(base: str, own: str, expected: str) -> None:
    assert join_namespaces(base, own) == expected


def test_launch_arguments() -> None:
    assert parse_arguments(['a:=1', 'b:=x:=y', 'a:=2']) == {'a': '2', 'b': 'x:=y'}
    for wrong in ('a', 'a:=', ':=b', 'a=b'):
        with pytest.raises(CommandError, match='malformed launch argument'):
            parse_arguments([wrong])
    with pytest.raises(CommandError, match=r"'launch-prefix' is not supported here; a full ROS 2"):
        parse_arguments(['launch-prefix:=gdb'])


@pytest.mark.parametrize(('argv', 'message'), [
    (['run', 'nope', 'x'], "Package 'nope' not found"),
    (['run', 'dummies', 'x'], 'No executable found'),
    (['run', 'dummies', 'notes.txt'], 'No executable found'),
    (['pkg', 'prefix', 'nope'], 'Package not found'),
    (['pkg', 'prefix', 'nope', '--share'], 'Package not found'),
    (['doctor'], "invalid choice: 'doctor' (choose from 'run', 'launch', "),
    (['doctor'], '; a full ROS 2 supports more'),
    (['pkg', 'xml'], "invalid choice: 'xml' (choose from 'executables', 'list', 'prefix'); a f"),
    (['launch', 'nope.yaml'], 'No launch file supplied'),
    (['launch', 'dummies', 'nope.yaml'], "file 'nope.yaml' was not found in the share directory"),
])
def test_errors_match_the_wording_of_the_real_command(
        argv: list[str], message: str, index: Path) -> None:
    assert message in str(main(argv))


def test_packages(index: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for argv in (['pkg', 'list'], ['pkg', 'executables', 'dummies'], ['pkg', 'prefix', 'dummies'],
                 ['pkg', 'prefix', '--share', 'dummies']):
        assert main(argv) == 0
    assert capsys.readouterr().out == (
        f'dummies\ndummies talker\n{index}\n{index}/share/dummies\n')


def test_options_of_a_full_ros_2_are_refused_by_name(
        index: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for argv, text in (
        (['pkg', 'executables', '--full-path', 'dummies'],
         "ros2 pkg executables: error: argument '--full-path' is not supported here, only -h, "
         '--help, package_name; a full ROS 2 supports more\n'),
        (['launch', '--show-args', 'x'], "ros2 launch: error: argument '--show-args' is not "
         'supported here, only -h, --help, -n, --noninteractive, '),
    ):
        with pytest.raises(SystemExit) as ended:
            main(argv)
        assert ended.value.code == 2
        assert capsys.readouterr().err.startswith(text)


def test_help_lists_commands_and_verbs(
        index: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['-h']) == 0
    assert '  launch      Run a launch file\n' in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(['pkg'])
    assert '  prefix      Output the prefix path of a package\n' in capsys.readouterr().out


def test_run_becomes_the_executable(index: Path) -> None:
    done = subprocess.run(
        [sys.executable, '-c', _ENTRY, 'run', 'dummies', 'talker', '--ros-args', '-p', 'a:=1'],
        capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (7, '--ros-args -p a:=1\n')


_ENTRY = f'import sys; sys.path.insert(0, {str(_SCRIPTS)!r}); ' \
         'from ros2.main import main; sys.exit(main())'

class Launch:
    """Starts launch files, given as text, whose nodes are shell scripts."""

    def __init__(self, tmp_path: Path, index: Path) -> None:
        self.file = tmp_path / 'test.launch.yaml'
        self.index = index
        self.command = [sys.executable, '-c', _ENTRY, 'launch', str(self.file)]
        self.environment = {
            **os.environ, 'ROS_LOG_DIR': str(tmp_path / 'logs'), 'PYTHONUNBUFFERED': '1'}

    def write(self, **nodes: str) -> None:
        """Write the file: by the name of a node its attributes, then || and its script."""
        lines = ['launch:']
        for name, text in nodes.items():
            attributes, _, script = text.partition('||')
            path = self.index / 'lib/dummies' / name
            path.write_text(f'#!/bin/sh\n{script}\n')
            path.chmod(0o755)
            lines.append(f'- node: {{pkg: dummies, exec: {name}, name: {name}, {attributes}}}')
        self.file.write_text('\n'.join(lines))

    def __call__(self, **nodes: str) -> subprocess.Popen[str]:
        """Write the file and start it."""
        self.write(**nodes)
        return self.start()

    def start(self) -> subprocess.Popen[str]:
        return subprocess.Popen(
            self.command, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            env=self.environment)


@pytest.fixture
def launch(tmp_path: Path, index: Path) -> Launch:
    return Launch(tmp_path, index)


def child_of(run: subprocess.Popen[str], ready: str) -> tuple[int, str]:
    """Return the id of the first process started, and the line with `ready` once one prints it."""
    assert run.stdout is not None
    pid = 0
    for line in run.stdout:
        if 'started with pid' in line and not pid:
            pid = int(line.rsplit('[', 1)[1].rstrip(']\n'))
        if ready in line:
            assert pid, line
            return pid, line
    raise AssertionError(f'{ready!r} did not come')


def alive(pid: int) -> bool:
    try:
        return 'Z' not in Path(f'/proc/{pid}/stat').read_text().rsplit(')', 1)[1].split()[0]
    except OSError:
        return False


def test_the_end_of_one_process_ends_all(launch: Launch) -> None:
    run = launch(
        sleeper='|| exec sleep 60', agent='output: screen, on_exit: shutdown || echo hello')
    output, _ = run.communicate(timeout=20)
    assert run.returncode == 0, output
    assert '[agent-2] hello' in output
    assert 'process has finished cleanly' in output
    assert "[INFO] [sleeper-1]: sending signal 'SIGINT' to process[sleeper-1]" in output


def test_a_failure_is_returned_and_its_log_shown(launch: Launch, tmp_path: Path) -> None:
    run = launch(bad='|| echo why; exit 3')
    output, _ = run.communicate(timeout=20)
    assert run.returncode == 3
    assert 'process has died' in output
    assert 'exit code 3' in output
    assert '[bad-1] why' in output.split('last lines of bad-1')[1]
    assert '[bad-1] why' in (tmp_path / 'logs/latest/launch.log').read_text()


def test_a_process_that_respawns_is_started_again_and_its_end_is_no_failure(
        launch: Launch, tmp_path: Path) -> None:
    count = tmp_path / 'count'
    run = launch(
        again=f'output: screen, respawn: true, respawn_delay: 0.1 || echo x >> {count}; '
              f'[ $(wc -l < {count}) -gt 2 ] && exec sleep 60; kill -9 $$',
        agent=f'on_exit: shutdown || until [ "$(cat {count} | wc -l)" = 3 ]; do sleep 0.1; done')
    output, _ = run.communicate(timeout=20)
    assert run.returncode == 0, output
    assert output.count('[again-1]: process started with pid') == 3
    assert output.count('exit code -9') == 2


def test_a_process_that_waits_to_respawn_does_not_delay_the_end(launch: Launch) -> None:
    run = launch(
        again='respawn: true, respawn_delay: 60 || exit 1',
        agent='on_exit: shutdown || sleep 0.5')
    output, _ = run.communicate(timeout=20)
    assert run.returncode == 0, output
    assert output.count('[again-1]: process started with pid') == 1


def test_a_program_that_cannot_be_started_is_named(launch: Launch) -> None:
    launch.write(ghost='||')
    path = launch.index / 'lib/dummies/ghost'
    path.write_text('#!/no/such/thing\n')
    run = launch.start()
    output, _ = run.communicate(timeout=20)
    assert run.returncode == 1
    assert f"cannot start '{path}': No such file or directory" in output


def test_interrupt_escalates_to_a_stubborn_process_and_its_children(launch: Launch) -> None:
    launch.command[2] = _ENTRY.replace(
        'sys.exit', 'import ros2.launch.process as p; p._SIGKILL_SECONDS = 0.3; sys.exit')
    run = launch(mule="output: screen, sigterm_timeout: 0.2 || "
                      "trap '' INT TERM; sleep 60 & echo ready $!; wait")
    pid, line = child_of(run, 'ready')
    run.send_signal(signal.SIGINT)
    output, _ = run.communicate(timeout=20)
    assert 'user interrupted with ctrl-c (SIGINT)' in output
    assert "'0.2' seconds after receiving 'SIGINT', escalating to 'SIGTERM'" in output
    assert "'0.5' seconds after receiving 'SIGTERM', escalating to 'SIGKILL'" in output
    assert not alive(pid)
    assert not alive(int(line.split()[-1]))


def test_a_python_that_is_still_starting_prints_no_traceback(launch: Launch) -> None:
    run = launch(s=f'output: screen || exec {sys.executable} -c '
                   '"import time; print(1, flush=True); time.sleep(60)"')
    pid, _ = child_of(run, '[s-1] 1')
    run.send_signal(signal.SIGINT)
    output, _ = run.communicate(timeout=20)
    assert 'Traceback' not in output
    assert not alive(pid)


def test_terminate_is_a_failure(launch: Launch) -> None:
    run = launch(s='output: screen || echo ready; exec sleep 60')
    pid, _ = child_of(run, 'ready')
    run.terminate()
    run.communicate(timeout=20)
    assert run.returncode == 1
    assert not alive(pid)


def test_a_child_that_holds_the_pipe_does_not_hide_an_exit(launch: Launch) -> None:
    run = launch(s='on_exit: shutdown || sleep 60 & exit 3')
    output, _ = run.communicate(timeout=20)
    assert 'exit code 3' in output


def test_nohup_protects_a_launch_from_hang_up(launch: Launch) -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        run = launch(s='output: screen || echo ready; exec sleep 1')
    finally:
        signal.signal(signal.SIGHUP, before)
    child_of(run, 'ready')
    run.send_signal(signal.SIGHUP)
    output, _ = run.communicate(timeout=20)
    assert 'process has finished cleanly' in output
    assert run.returncode == 0


def test_a_signal_during_its_creation_ends_a_process(tmp_path: Path) -> None:
    plan = ProcessPlan('sleeper', ('sleep', '60'))

    async def run() -> int:
        process = Process(plan, Log(tmp_path / 'logs'), False, False)
        running = asyncio.create_task(process.run())
        await asyncio.sleep(0)  # it has begun, and waits for the system
        process._send(signal.SIGTERM)
        return await asyncio.wait_for(running, 20.0)

    assert asyncio.run(run()) == -signal.SIGTERM


def test_characters_outside_the_encoding_are_escaped(tmp_path: Path) -> None:
    code = (f'import sys; sys.path.insert(0, {str(_SCRIPTS)!r})\n'
            'from pathlib import Path; from ros2.launch.log import Log\n'
            f'log = Log(Path({str(tmp_path / "logs")!r}))\n'
            "log.output('node', 'caf\u00e9 \u2192', to_screen=True, to_file=True)\n")
    done = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, timeout=30, check=False,
        env={**os.environ, 'PYTHONIOENCODING': 'latin-1'})
    assert (done.returncode, done.stdout) == (0, '[node] café \\u2192\n'.encode('latin-1'))


# Ctrl-C that comes before a child has had the time to hear of it.
_SLOW = '#!/bin/sh\nsleep 1.5\nexec {python} "$@"\n'


def test_ctrl_c_reaches_a_child_that_is_still_starting(tmp_path: Path) -> None:
    (tmp_path / 'python3').write_text(_SLOW.format(python=sys.executable))
    (tmp_path / 'python3').chmod(0o755)
    script = (f'set -eu; . {_SCRIPTS}/attend.sh; pass_on_signals INT; echo ready; '
              'attend sleep 60; echo "$stopped $status"')
    run = subprocess.Popen(
        ['bash', '-c', script], stdout=subprocess.PIPE, text=True,
        env={**os.environ, 'PATH': f'{tmp_path}:{os.environ["PATH"]}'})
    assert run.stdout is not None
    assert run.stdout.readline() == 'ready\n'
    time.sleep(0.5)
    run.send_signal(signal.SIGINT)
    assert run.communicate(timeout=20)[0] == 'INT 143\n'


def test_a_full_disk_does_not_keep_a_launch_from_ending(
    tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    log = Log(tmp_path / 'logs')
    log._file.close()
    log._file = Path('/dev/full').open('w', encoding='utf-8', buffering=1)  # noqa: SIM115
    for _ in range(3):
        log.message('INFO', 'launch', 'going on')
        log.output('node', 'so am I', to_screen=True, to_file=True)
    log.close()
    assert capsys.readouterr().out.count('[node] so am I') == 3


def test_no_process_outlives_a_launch_that_is_killed(launch: Launch) -> None:
    run = launch(
        mule="output: screen || trap '' INT TERM; echo ready; while true; do sleep 0.1; done")
    pid, _ = child_of(run, 'ready')
    run.kill()
    run.wait()
    end = time.monotonic() + 5.0
    while alive(pid):
        assert time.monotonic() < end, 'the child lives on'
        time.sleep(0.02)
    assert run.stdout is not None
    run.stdout.close()


def test_a_single_screen_process_gets_the_terminal(launch: Launch, tmp_path: Path) -> None:
    said = tmp_path / 'said'
    launch.write(
        talker=f'|| echo hidden; echo hidden >&2; touch {said}; sleep 60',
        live='output: screen, on_exit: shutdown || '
             f'while ! test -e {said}; do sleep 0.1; done; test -t 1 && echo live')
    main_end, other_end = os.openpty()
    run = subprocess.Popen(
        launch.command, stdin=other_end, stdout=other_end, stderr=other_end,
        env=launch.environment)
    os.close(other_end)
    assert run.wait(20) == 0
    output = os.read(main_end, 65536).decode()
    os.close(main_end)
    assert output.splitlines() == ['live']
    assert 'hidden' in (tmp_path / 'logs/latest/launch.log').read_text()


def test_messages_as_yaml() -> None:
    messages = pytest.importorskip('ros2.messages', reason='needs NumPy')

    class Inner:
        x = 1.5

        def get_fields_and_field_types(self) -> dict[str, str]:
            return {'x': 'double'}

    class Message:
        text = 'abcdef'
        long = 'x' * 129
        numbers = (1, 2, 3)
        many = array.array('d', range(129))
        inner = Inner()

        def get_fields_and_field_types(self) -> dict[str, str]:
            return dict.fromkeys(('text', 'long', 'numbers', 'many', 'inner'), '')

    assert messages.to_yaml(Message()) == (
        'text: abcdef\nlong: ' + 'x' * 128 + '...\nnumbers:\n- 1\n- 2\n- 3\nmany:\n'
        + ''.join(f'- {number}.0\n' for number in range(128)) + "- '...'\ninner:\n  x: 1.5\n")


RESET = 'service', 'call', '/simulator/reset', 'rocket_msgs/srv/Reset'
LAND = 'action', 'send_goal', '/land', 'rocket_msgs/action/Land'


@pytest.mark.parametrize(('command', 'values', 'field'), [
    (RESET, '{agent: abc}', 'agent'), (RESET, '{agent: -1}', 'agent'),
    (RESET, '{seed: 1.5}', 'seed'), (RESET, '{seed: 9223372036854775808}', 'seed'),
    (RESET, '{settings: [{name: 5}]}', 'settings name'), (LAND, '{policy: 5}', 'policy'),
    (LAND, '{arguments: [5]}', 'arguments'), (LAND, '{thrust: 5}', 'thrust')])
def test_a_value_of_another_type_is_refused_and_no_abort(
        command: tuple[str, ...], values: str, field: str) -> None:
    pytest.importorskip('rocket_msgs', reason='needs the workspace')
    done = subprocess.run(
        [sys.executable, '-c', _ENTRY, *command, values], text=True, capture_output=True,
        timeout=60)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith(f'Failed to populate field: {field}: ')
    assert 'Traceback' not in done.stderr


def test_a_decompression_bomb_is_not_played(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    from support.recording.bags import write_records
    bomb = zstandard.compress(bytes(1 << 30))
    write_records(tmp_path / 'bag_0.mcap', [
        Schema(data=b'', encoding='ros2msg', id=1, name='a/msg/A'),
        Channel(id=1, topic='/a', message_encoding='cdr', metadata={}, schema_id=1),
        Chunk('zstd', bomb, 0, 0, 0, 1000)])
    topic = {'name': '/a', 'type': 'a/msg/A', 'serialization_format': 'cdr',
             'offered_qos_profiles': []}
    (tmp_path / 'metadata.yaml').write_text(yaml.safe_dump({'rosbag2_bagfile_information': {
        'storage_identifier': 'mcap', 'relative_file_paths': ['bag_0.mcap'], 'message_count': 1,
        'starting_time': {'nanoseconds_since_epoch': 0}, 'duration': {'nanoseconds': 0},
        'topics_with_message_count': [{'topic_metadata': topic, 'message_count': 1}]}}))
    monkeypatch.setattr(bag.graph, 'direct_node', nullcontext)
    monkeypatch.setattr(bag, '_publisher', lambda node, topic: None)
    monkeypatch.setattr(bag, '_MATCH_SECONDS', 0.0)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert main(['bag', 'info', str(tmp_path)]) == 0, 'it reads no messages'
    assert main(['bag', 'play', str(tmp_path)]) == (
        f'{tmp_path}: a chunk claims 1000 bytes, and holds more')
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100 << 10, 'KiB'


def test_an_untrusted_bag_cannot_control_the_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    topic = {'name': '/a\x1b[2J', 'type': 'b', 'serialization_format': 'cdr'}
    (tmp_path / 'metadata.yaml').write_text(yaml.safe_dump({'rosbag2_bagfile_information': {
        'storage_identifier': 'mcap', 'relative_file_paths': [], 'message_count': 0,
        'starting_time': {'nanoseconds_since_epoch': 0}, 'duration': {'nanoseconds': 0},
        'topics_with_message_count': [{'topic_metadata': topic, 'message_count': 0}],
        'ros_distro': '\x1b]0;x\x07', 'custom_data': {'\x1b[31m': '\x9b2J'}}}))
    assert main(['bag', 'info', str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert 'Topic: /a [2J' in said
    assert all(line.isprintable() for line in said.splitlines())
