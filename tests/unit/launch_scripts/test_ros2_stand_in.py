# SPDX-License-Identifier: Apache-2.0
"""The stand-in for the ros2 command: launch files, substitutions, processes, messages."""
from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from ros2.errors import CommandError
from ros2.launch.actions import Plan
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
    return Context({'n': '3', 'name': 'a b', 'yes': 'True'}, {'HOME': '/h'}, tmp_path / 'log',
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
    plan = Plan()
    carry_out(context.file, context, plan)
    return plan.processes


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
    ('$(var missing other)', 'other'),
    ("$(var missing '$(var n) x')", '3 x'),
    (r'\$(var n)', '$(var n)'),
    ('costs $5', 'costs $5'),
    ('$(env HOME)/x', '/h/x'),
    ('$(env NO_SUCH none)', 'none'),
    ('$(not $(var yes))', 'false'),
    ('$(and true $(var yes))', 'true'),
    ('$(or false 0)', 'false'),
    ('$(equals $(var n) 3.0)', 'true'),
    ('$(equals a b)', 'false'),
    ('$(not-equals a b)', 'true'),
    ('$(if $(var yes) one two)', 'one'),
    ("$(eval '$(var n) * 2 + 1')", '7'),
    ('$(eval "\'$(var n)\' == \'3\' and 2 > 1")', 'True'),
])
def test_substitutions(text: str, expected: str, context: Context) -> None:
    assert substitute(text, context) == expected


@pytest.mark.parametrize(('text', 'message'), [
    ('$(var missing)', "launch configuration 'missing' does not exist"),
    ('$(env NO_SUCH)', "environment variable 'NO_SUCH' does not exist"),
    ('$(command ls)', r'substitution \$\(command\) is not supported'),
    ('$(var)', 'takes 1 to 2 arguments'),
    ('$(var n', 'not a substitution of the form'),
    ("$(var 'n)", 'quote is not closed'),
    ('$(not maybe)', "condition 'maybe' is neither true nor false"),
    ('$(eval "open(1)")', 'only constants and operators'),
    ('$(eval "1 / 0")', 'division by zero'),
    ('$(eval "\'a\' * 99999999999")', 'only numbers can be multiplied'),
])
def test_wrong_substitutions_say_why(text: str, message: str, context: Context) -> None:
    with pytest.raises(LaunchError, match=message):
        substitute(text, context)


def test_dirname_is_that_of_the_launch_file(context: Context) -> None:
    plan, = plan_of('launch:\n- executable: {cmd: $(dirname)/x}\n', context)
    assert plan.command == (str(context.file.parent / 'x'),)


def test_substituted_values_are_typed_by_yaml_and_plain_ones_keep_their_type(
        context: Context, index: Path) -> None:
    context.arguments.update(
        {'f': '1.0', 'e': '1e-3', 's': 'abc', 't': 'true', 'l': '[1, 2]', 'empty': ''})
    plan, = plan_of("""
launch:
- node:
    pkg: dummies
    exec: talker
    param:
    - {name: int, value: $(var n)}
    - {name: float, value: $(var f)}
    - {name: string, value: $(var s)}
    - {name: bool, value: $(var t)}
    - {name: list, value: $(var l)}
    - {name: empty, value: $(var empty)}
    - {name: path, value: $(var s)/$(var n)}
    - {name: plain_int, value: 1}
    - {name: plain_float, value: 1.0}
    - {name: plain_string, value: '1'}
    - {name: mixed, value: [1, 2.5]}
    - {name: forced, value: $(var n), type: str}
    - {name: forced_float, value: $(var n), type: float}
    - {name: outer, param: [{name: inner, value: true}]}
""", context)
    values = parameters_of(plan)
    expected = {
        'int': 3, 'float': 1.0, 'string': 'abc', 'bool': True, 'list': [1, 2], 'empty': '',
        'path': 'abc/3', 'plain_int': 1, 'plain_float': 1.0, 'plain_string': '1',
        'mixed': [1.0, 2.5], 'forced': '3', 'forced_float': 3.0, 'outer.inner': True}
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
    param:
    - {{name: a, value: 1}}
    - {{from: {file}}}
    - {{name: b, value: 3}}
""", context)
    assert parameters_of(plan) == {'a': 2, 'b': 3}


def test_a_node_becomes_a_command_line(context: Context, index: Path) -> None:
    plan, = plan_of("""
launch:
- group:
  - push_ros_namespace: {namespace: fleet}
  - node:
      pkg: dummies
      exec: talker
      name: t$(var n)
      namespace: one
      args: --name "$(var name)" plain
      remap: [{from: a, to: b}]
      env: [{name: X, value: $(var n)}]
""", context)
    assert plan.name == 'talker-1'
    assert plan.command == (
        str(index / 'lib/dummies/talker'), '--name', 'a b', 'plain', '--ros-args',
        '-r', '__node:=t3', '-r', '__ns:=/fleet/one', '-r', 'a:=b')
    assert plan.environment == {'HOME': '/h', 'X': '3'}


def test_scopes_conditions_and_includes(context: Context) -> None:
    other = context.file.parent / 'other.yaml'
    other.write_text('launch:\n- arg: {name: k, default: d}\n- executable: {cmd: "in $(var k)"}\n')
    plans = plan_of(f"""
launch:
- group:
  - let: {{name: n, value: inner}}
  - set_env: {{name: V, value: set}}
  - executable: {{cmd: a $(var n)}}
- executable: {{cmd: b $(var n), if: $(var yes)}}
- executable: {{cmd: c, unless: $(var yes)}}
- include: {{file: {other}, arg: [{{name: k, value: given}}]}}
""", context)
    assert [plan.command for plan in plans] == [('a', 'inner'), ('b', '3'), ('in', 'given')]
    assert [plan.environment.get('V') for plan in plans] == ['set', None, None]


@pytest.mark.parametrize(('entry', 'message'), [
    ('{foo: {}}', "entry 'foo' is not supported"),
    ('{node: {exec: x, composable: y}}', r"node 'x': key 'composable' is not supported here"),
    ('{arg: {name: a, default: 3}}', "arg 'a': 'default' must be a text, got 3"),
    ('{arg: {name: a}}', 'Required launch argument "a"'),
    ('{arg: {name: n, choice: [{value: "1"}]}}', r"Valid options are: \['1'\]"),
    ('{node: {pkg: dummies, exec: x}}', "executable 'x' not found on the libexec directory"),
    ('{node: {pkg: nope, exec: x}}', "Package 'nope' not found"),
    ('{node: {pkg: dummies, exec: talker, param: [{name: a, value: null}]}}', 'results in None'),
    ('{node: {pkg: dummies, exec: talker, param: [{name: a, value: [1, a]}]}}', 'one type'),
    ('{node: {pkg: dummies, exec: talker, param: [{from: /nope}]}}', "parameter file '/nope'"),
    ('{executable: {cmd: a, output: everywhere}}', "output 'everywhere' is not one of"),
    ('{executable: {cmd: a, on_exit: restart}}', "on_exit 'restart' is not supported"),
    ('{executable: {cmd: a, if: maybe}}', "condition 'maybe' is neither true nor false"),
    ('{executable: {cmd: a, respawn_delay: -1}}', "'respawn_delay' must be a number"),
    ('{executable: {cmd: "a \'b"}}', 'No closing quotation'),
])
def test_errors_name_the_file_and_the_entry(
        entry: str, message: str, context: Context, index: Path) -> None:
    with pytest.raises(LaunchError, match=message) as caught:
        plan_of(f'launch:\n- {entry}\n', context)
    assert str(caught.value).startswith(str(context.file))


@pytest.mark.parametrize(('text', 'message'), [
    ('launch: [', 'not valid YAML'), ('nodes: []', "expected 'launch' as root tag"),
    ('launch: {}', 'expected a list of entries'), ('launch: [a]', 'entry 1 must have one key'),
])
def test_files_that_are_no_launch_files(text: str, message: str, context: Context) -> None:
    with pytest.raises(LaunchError, match=message):
        plan_of(text, context)


@pytest.mark.parametrize(('base', 'own', 'expected'), [
    ('', None, ''), ('', 'a', '/a'), ('/a', None, '/a'), ('/a', 'b', '/a/b'), ('/a', '/b', '/b')])
def test_namespaces(base: str, own: str | None, expected: str) -> None:
    assert join_namespaces(base, own) == expected


def test_launch_arguments() -> None:
    assert parse_arguments(['a:=1', 'b:=x:=y', 'a:=2']) == {'a': '2', 'b': 'x:=y'}
    for wrong in ('a', 'a:=', ':=b', 'a=b'):
        with pytest.raises(CommandError, match='malformed launch argument'):
            parse_arguments([wrong])


@pytest.mark.parametrize(('argv', 'message'), [
    (['run', 'nope', 'x'], "Package 'nope' not found"),
    (['run', 'dummies', 'x'], 'No executable found'),
    (['run', 'dummies', 'notes.txt'], 'No executable found'),
    (['pkg', 'prefix', 'nope'], 'Package not found'),
    (['bag', 'play'], "invalid choice: 'bag'"),
    (['topic', 'bw'], "invalid choice: 'bw'"),
    (['launch', 'nope.yaml'], 'No launch file supplied'),
    (['launch', 'dummies', 'nope.yaml'], "file 'nope.yaml' was not found in the share directory"),
])
def test_errors_in_the_words_of_the_real_command(
        argv: list[str], message: str, index: Path) -> None:
    assert message in str(main(argv))


def test_packages(index: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for argv in (['pkg', 'list'], ['pkg', 'executables', 'dummies'], ['pkg', 'prefix', 'dummies']):
        assert main(argv) == 0
    assert capsys.readouterr().out == f'dummies\ndummies talker\n{index}\n'


def test_show_args(context: Context, capsys: pytest.CaptureFixture[str]) -> None:
    context.file.write_text(
        "launch:\n- arg: {name: a, default: 'x$(var b)', description: d, choice: [{value: x}]}\n"
        '- arg: {name: c}\n')
    assert main(['launch', str(context.file), '--show-args']) == 0
    assert capsys.readouterr().out == (
        "Arguments (pass arguments as '<name>:=<value>'):\n"
        "\n    'a':\n        d. Valid choices are: ['x']\n        (default: 'x' + $(var b))\n"
        "\n    'c':\n        no description given\n")


def test_run_becomes_the_executable(index: Path) -> None:
    done = subprocess.run(
        [sys.executable, '-c', _ENTRY, 'run', 'dummies', 'talker', '--ros-args', '-p', 'a:=1'],
        capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (7, '--ros-args -p a:=1\n')


_ENTRY = f'import sys; sys.path.insert(0, {str(_SCRIPTS)!r}); ' \
         'from ros2.main import main; sys.exit(main())'

Launch = Callable[[str], 'subprocess.Popen[str]']


@pytest.fixture
def launch(tmp_path: Path) -> Launch:
    """Start a launch file, given as text, in a process of its own."""
    def start(text: str) -> subprocess.Popen[str]:
        file = tmp_path / 'test.launch.yaml'
        file.write_text(text)
        return subprocess.Popen(
            [sys.executable, '-c', _ENTRY, 'launch', str(file)], text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            env={**os.environ, 'ROS_LOG_DIR': str(tmp_path / 'logs'), 'PYTHONUNBUFFERED': '1'})
    return start


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
    run = launch("""
launch:
- executable: {cmd: sleep 60, name: sleeper}
- executable: {cmd: sh -c "echo hello; exit 0", name: agent, output: screen, on_exit: shutdown}
""")
    output, _ = run.communicate(timeout=20)
    assert run.returncode == 0, output
    assert '[agent-2] hello' in output
    assert 'process has finished cleanly' in output
    assert "[INFO] [sleeper-1]: sending signal 'SIGINT' to process[sleeper-1]" in output


def test_a_failure_is_returned_and_its_log_shown(launch: Launch, tmp_path: Path) -> None:
    run = launch('launch:\n- executable: {cmd: sh -c "echo why; exit 3", name: bad}\n')
    output, _ = run.communicate(timeout=20)
    assert run.returncode == 1
    assert 'process has died' in output
    assert 'exit code 3' in output
    assert '[bad-1] why' in output.split('last lines of bad-1')[1]
    assert '[bad-1] why' in (tmp_path / 'logs/latest/launch.log').read_text()


def test_what_cannot_be_started_is_named(launch: Launch) -> None:
    run = launch('launch:\n- executable: {cmd: /no/such/thing}\n')
    output, _ = run.communicate(timeout=20)
    assert run.returncode == 1
    assert "cannot start '/no/such/thing': No such file or directory" in output


def test_a_process_respawns(launch: Launch) -> None:
    run = launch('launch:\n- executable: {cmd: sh -c "echo again; exit 1", name: r, '
                 "respawn: 'true', respawn_max_retries: 2, output: screen}\n")
    output, _ = run.communicate(timeout=20)
    assert output.count('[r-1] again') == 3
    assert run.returncode == 1


def test_interrupt_escalates_to_a_stubborn_process_and_its_children(launch: Launch) -> None:
    run = launch("""
launch:
- executable:
    cmd: sh -c "trap '' INT TERM; sleep 60 & echo ready $!; wait"
    name: mule
    output: screen
    sigterm_timeout: 0.2
    sigkill_timeout: 0.2
""")
    pid, line = child_of(run, 'ready')
    run.send_signal(signal.SIGINT)
    output, _ = run.communicate(timeout=20)
    assert 'user interrupted with ctrl-c (SIGINT)' in output
    assert "'0.2' seconds after receiving 'SIGINT', escalating to 'SIGTERM'" in output
    assert "'0.4' seconds after receiving 'SIGTERM', escalating to 'SIGKILL'" in output
    assert not alive(pid)
    assert not alive(int(line.split()[-1]))


def test_terminate_is_a_failure(launch: Launch) -> None:
    run = launch('launch:\n- executable: {cmd: sh -c "echo ready; exec sleep 60", name: s, '
                 'output: screen}\n')
    pid, _ = child_of(run, 'ready')
    run.terminate()
    run.communicate(timeout=20)
    assert run.returncode == 1
    assert not alive(pid)


def test_who_holds_the_pipe_of_one_that_died_does_not_hide_it(launch: Launch) -> None:
    run = launch('launch:\n- executable: {cmd: sh -c "sleep 60 & exit 3", on_exit: shutdown}\n')
    output, _ = run.communicate(timeout=20)
    assert 'exit code 3' in output


def test_nohup_holds(launch: Launch) -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        run = launch('launch:\n- executable: {cmd: sh -c "echo ready; exec sleep 1", name: s, '
                     'output: screen}\n')
    finally:
        signal.signal(signal.SIGHUP, before)
    child_of(run, 'ready')
    run.send_signal(signal.SIGHUP)
    output, _ = run.communicate(timeout=20)
    assert 'process has finished cleanly' in output
    assert run.returncode == 0


def test_asked_to_end_while_it_is_being_made(tmp_path: Path) -> None:
    plan = ProcessPlan('sleeper', ('sleep', '60'), dict(os.environ))

    async def run() -> int:
        process = Process(plan, Log(tmp_path / 'logs', debug=False), False, False)
        running = asyncio.create_task(process.run())
        await asyncio.sleep(0)  # it has begun, and waits for the system
        process._send(signal.SIGTERM)
        return await asyncio.wait_for(running, 20.0)

    assert asyncio.run(run()) == -signal.SIGTERM


def test_what_the_terminal_cannot_show_is_shown_otherwise(tmp_path: Path) -> None:
    code = (f'import sys; sys.path.insert(0, {str(_SCRIPTS)!r})\n'
            'from pathlib import Path; from ros2.launch.log import Log\n'
            f'log = Log(Path({str(tmp_path / "logs")!r}), debug=False)\n'
            "log.output('node', 'caf\u00e9 \u2192', to_screen=True, to_file=True)\n")
    done = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, timeout=30, check=False,
        env={**os.environ, 'PYTHONIOENCODING': 'latin-1'})
    assert (done.returncode, done.stdout) == (0, '[node] café \\u2192\n'.encode('latin-1'))


# Ctrl-C that comes before a child has had the time to hear of it.
_SLOW = '#!/bin/sh\nsleep 1.5\nexec {python} "$@"\n'


def test_ctrl_c_is_not_lost_on_a_child_that_has_hardly_begun(tmp_path: Path) -> None:
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
    log = Log(tmp_path / 'logs', debug=False)
    log._file.close()
    log._file = Path('/dev/full').open('w', encoding='utf-8', buffering=1)  # noqa: SIM115
    for _ in range(3):
        log.message('INFO', 'launch', 'going on')
        log.output('node', 'so am I', to_screen=True, to_file=True)
    log.close()
    assert capsys.readouterr().out.count('[node] so am I') == 3


def test_no_process_outlives_a_launch_that_is_killed(launch: Launch) -> None:
    run = launch("""
launch:
- executable:
    cmd: sh -c "trap '' INT TERM; echo ready; while true; do sleep 0.1; done"
    output: screen
""")
    pid, _ = child_of(run, 'ready')
    run.kill()
    run.wait()
    end = time.monotonic() + 5.0
    while alive(pid):
        assert time.monotonic() < end, 'the child lives on'
        time.sleep(0.02)
    assert run.stdout is not None
    run.stdout.close()


def test_a_single_screen_process_gets_the_terminal(tmp_path: Path) -> None:
    file = tmp_path / 'test.launch.yaml'
    said = tmp_path / 'said'
    file.write_text(f"""
launch:
- executable: {{cmd: sh -c "echo hidden; echo hidden >&2; touch {said}; sleep 60"}}
- executable: {{cmd: sh -c "while ! test -e {said}; do sleep 0.1; done; test -t 1 && echo live",
    output: screen, on_exit: shutdown}}
""")
    main_end, other_end = os.openpty()
    run = subprocess.Popen(
        [sys.executable, '-c', _ENTRY, 'launch', str(file)], stdin=other_end, stdout=other_end,
        stderr=other_end, env={**os.environ, 'ROS_LOG_DIR': str(tmp_path / 'logs')})
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
        numbers = (1, 2, 3)
        inner = Inner()

        def get_fields_and_field_types(self) -> dict[str, str]:
            return {'text': 'string', 'numbers': 'sequence<int32>', 'inner': 'pkg/Inner'}

    assert messages.to_yaml(Message(), truncate=2) == (
        "text: ab...\nnumbers:\n- 1\n- 2\n- '...'\ninner:\n  x: 1.5\n")
    assert messages.to_plain(Message(), no_arr=True, no_str=True) == {
        'text': '<string length: <6>>', 'numbers': '<sequence type: int32, length: 3>',
        'inner': {'x': 1.5}}
    assert messages.to_csv(Message()) == 'abcdef,1,2,3,1.5'


@pytest.mark.parametrize(('values', 'field'), [
    ('{agent: abc}', 'agent'), ('{agent: -1}', 'agent'), ('{seed: 1.5}', 'seed'),
    ('{seed: 9223372036854775808}', 'seed'), ('{settings: [{name: 5}]}', 'settings name')])
def test_a_value_of_another_type_is_refused_and_no_abort(values: str, field: str) -> None:
    pytest.importorskip('rocket_msgs', reason='needs the workspace')
    done = subprocess.run(
        [sys.executable, '-c', _ENTRY, 'service', 'call', '/reset', 'rocket_msgs/srv/Reset',
         values], text=True, capture_output=True, timeout=60)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith(f'Failed to populate field: {field}: ')
    assert 'Traceback' not in done.stderr
