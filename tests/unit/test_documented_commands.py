# SPDX-License-Identifier: Apache-2.0
"""Every command in README and docs has a test, and its arguments and names exist.

`tests/system/commands/test_commands_of_documents.py` runs the commands.
"""
from __future__ import annotations

import argparse
import ast
import importlib
import re
import shlex
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
from benchmarks.parts import MODULES
from support.documented_commands import KINDS
from support.documented_commands import ROOT
from support.documented_commands import Command
from support.documented_commands import commands
from support.documented_commands import extended
from support.documented_commands import kind_of
from support.documented_commands import python_blocks

from ppo_agent_node.commands import arguments
from reference_pages.python_api import PUBLIC
from rocket_sim_node import worlds

SCRIPTS = ROOT / 'launch_scripts'
LAUNCH_FILES = ROOT / 'ppo_agent_node' / 'launch'
COMMANDS = commands()


class ParsedError(Exception):
    """Raised instead of what a benchmark would do."""


def of(script: str) -> list[Command]:
    """Return the commands that call a script."""
    return [each for each in COMMANDS if f'./launch_scripts/{script} ' in f'{each.text} ']


@pytest.mark.parametrize('command', COMMANDS, ids=str)
def test_a_command_is_run_or_tested_or_has_a_reason(command: Command) -> None:
    kind = kind_of(command)
    assert kind.is_run or bool(kind.tested) != bool(kind.reason)
    if kind.tested:
        file, _, name = kind.tested.partition('::')
        assert f'def {name}(' in (ROOT / file).read_text('utf-8'), kind.tested


def test_every_kind_matches_a_documented_command() -> None:
    used = [kind_of(command).pattern for command in COMMANDS]
    assert [kind.pattern for kind in KINDS if kind.pattern not in used] == []


@pytest.mark.parametrize(
    'command', [each for name in arguments.COMMANDS for each in of(name)], ids=str)
def test_a_command_is_run_with_each_argument_once(command: Command) -> None:
    kind = kind_of(command)
    if kind.is_run:
        words = [each.split(':=')[0] for each in extended(command.text, kind.append).split()]
        assert len(words) == len(set(words))


def test_a_new_command_is_noticed() -> None:
    with pytest.raises(LookupError, match='a new command'):
        kind_of(Command('./launch_scripts/dance', 'README.md'))


@pytest.mark.parametrize(
    'command', [each for name in arguments.COMMANDS for each in of(name)], ids=str)
def test_arguments_of_a_command_are_known(
        command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    run = tmp_path / 'runs' / '<name>'
    run.mkdir(parents=True)
    (run / 'config.yaml').write_text('world: rocket\n')
    script, *words = shlex.split(command.text)
    name = script.rpartition('/')[2]
    given = [word for word in words if word != '--help']
    if '--help' in words:
        found = arguments.parse(name, LAUNCH_FILES / f'{name}.launch.yaml', [])
        known = {info.name for group in arguments.agent_settings(name).values() for info in group}
        assert set(given) <= known | found.declared.keys()
    else:
        arguments.parse(name, LAUNCH_FILES / f'{name}.launch.yaml', given)


@pytest.mark.parametrize(
    'command', [each for each in of('bench') if ' ' in each.text and 'PART' not in each.text],
    ids=str)
def test_options_of_a_benchmark_are_known(
        command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    _, part, *options = shlex.split(command.text.replace('NAME', 'claims'))
    try:
        main = importlib.import_module(MODULES[part]).main
    except ModuleNotFoundError as missing:
        pytest.skip(f'{missing.name} is not installed; ./launch_scripts/bench installs it')
    parse = argparse.ArgumentParser.parse_args

    def parse_alone(self: argparse.ArgumentParser, *given: Any, **named: Any) -> None:
        parse(self, *given, **named)
        raise ParsedError

    monkeypatch.setattr('sys.argv', [part, *options])
    with (
            mock.patch.object(argparse.ArgumentParser, 'parse_args', parse_alone),
            pytest.raises(ParsedError)):
        main()


@pytest.mark.parametrize('command', of('test'), ids=str)
def test_tests_that_a_command_names_exist(command: Command) -> None:
    words = shlex.split(command.text)
    files = [word for word in words if word.startswith('tests/')]
    assert all((ROOT / file).exists() for file in files)
    for file, wanted in zip(files, re.findall(r'-k (\w+)', command.text), strict=False):
        tests = [ROOT / file] if file.endswith('.py') else (ROOT / file).rglob('test_*.py')
        assert any(wanted in str(each) or wanted in each.read_text('utf-8') for each in tests)


@pytest.mark.parametrize(('page', 'code'), list(python_blocks()))
def test_names_in_the_python_of_a_page_exist(page: str, code: str) -> None:
    modules: dict[str, Any] = {}
    tree = ast.parse(code)
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                modules[alias.asname or alias.name] = importlib.import_module(alias.name)
        elif isinstance(node, ast.ImportFrom):
            module = importlib.import_module(str(node.module))
            for alias in node.names:
                path = f'{node.module}.{alias.name}'
                if not hasattr(module, alias.name):
                    importlib.import_module(path)
                modules[alias.asname or alias.name] = getattr(module, alias.name)
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            known = modules.get(node.value.id)
            assert known is None or hasattr(known, node.attr), f'{page}: {ast.unparse(node)}'


def test_the_python_of_the_pages_uses_public_names_only() -> None:
    public = {f'{module}.{name}' for module, names in PUBLIC.items() for name in names}
    used = {
        f'{node.module}.{alias.name}' for _, code in python_blocks()
        for node in ast.walk(ast.parse(code)) if isinstance(node, ast.ImportFrom)
        and str(node.module).startswith(('rocket_sim_node', 'ppo_agent_node'))
        for alias in node.names}
    assert used
    assert used <= public | PUBLIC.keys()
    assert set(PUBLIC['rocket_sim_node.worlds']) == set(worlds.__all__)
