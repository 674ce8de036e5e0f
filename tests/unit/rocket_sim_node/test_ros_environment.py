# SPDX-License-Identifier: Apache-2.0
"""Environment variables of ROS 2: refused by name, or completed."""
from __future__ import annotations

import os
import pwd
from pathlib import Path
from types import SimpleNamespace

import pytest

from rocket_sim_node import ros_environment


@pytest.mark.parametrize('value', ['', '0', '42', '232'])
def test_a_domain_of_ros_is_accepted(value: str) -> None:
    ros_environment.check({'ROS_DOMAIN_ID': value})
    ros_environment.check({})


@pytest.mark.parametrize('value', ['abc', '-1', '233', '1.5', '0x10', '9' * 30, '٣'])
def test_an_invalid_domain_is_named(value: str) -> None:
    with pytest.raises(ValueError, match=f"ROS_DOMAIN_ID: got '{value}', expected a whole number"):
        ros_environment.check({'ROS_DOMAIN_ID': value})


@pytest.mark.parametrize('name', [
    'ROS_DISCOVERY_SERVER', 'ROS_STATIC_PEERS', 'ROS_AUTOMATIC_DISCOVERY_RANGE'])
def test_the_advice_names_only_variables_that_are_set(name: str) -> None:
    plain = ros_environment.advice({})
    assert 'ROS_DOMAIN_ID and namespace' in plain
    assert name not in plain
    assert ros_environment.advice({name: ''}) == plain
    text = ros_environment.advice({name: 'x' * 500, 'ROS_DOMAIN_ID': '3'})
    assert f'{name}={"x" * 100},' in text
    assert text.isprintable()


def test_full_shared_memory_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ros_environment.check_shared_memory(tmp_path)
    ros_environment.check_shared_memory(tmp_path / 'none')
    monkeypatch.setattr(
        ros_environment.shutil, 'disk_usage', lambda path: SimpleNamespace(free=4096))
    with pytest.raises(OSError, match=f'^{tmp_path}: got 4 KiB free, expected 64 or more'):
        ros_environment.check_shared_memory(tmp_path)


def test_a_home_is_found_where_no_variable_is_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv('HOME', raising=False)
    for given in ({}, {'HOME': ''}):
        environ = dict(given)
        ros_environment.complete(environ)
        assert environ == {'HOME': pwd.getpwuid(os.getuid()).pw_dir}
    for name in ('HOME', 'ROS_HOME', 'ROS_LOG_DIR'):
        environ = {name: '/x'}
        ros_environment.complete(environ)
        assert environ == {name: '/x'}
    monkeypatch.setattr(os.path, 'expanduser', lambda path: path)
    with pytest.raises(ValueError, match='HOME: got none, expected a folder'):
        ros_environment.complete({})
