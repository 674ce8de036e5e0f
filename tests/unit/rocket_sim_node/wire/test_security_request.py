# SPDX-License-Identifier: Apache-2.0
"""Requested security is enforced or refused with a reason; and the policy's form."""
from __future__ import annotations

import os
from pathlib import Path
from xml.etree import ElementTree

import pytest

from rocket_sim_node.wire.dds import security
from rocket_sim_node.wire.dds.security import SecurityError
from rocket_sim_node.wire.dds.security import require

SUPPORTED = security.supported
POLICY = Path(__file__).parents[4] / 'launch_scripts' / 'security' / 'hoverslam.policy.xml'


@pytest.fixture(autouse=True)
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """An environment without security settings, and a middleware that has security."""
    for name in (security.ENABLE, security.STRATEGY, security.KEYSTORE, security.OVERRIDE):
        monkeypatch.setenv(name, '')
        monkeypatch.delenv(name)
    monkeypatch.setattr(security, 'supported', lambda: True)


@pytest.fixture
def keystore(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The keys of one node, with security requested."""
    enclave = tmp_path / 'enclaves' / 'hoverslam' / 'simulator'
    enclave.mkdir(parents=True)
    for name in security.FILES:
        (enclave / name).write_text('')
    monkeypatch.setenv(security.ENABLE, 'true')
    monkeypatch.setenv(security.KEYSTORE, str(tmp_path))
    return tmp_path


@pytest.mark.parametrize('value', ['', 'false'])
def test_without_a_request_security_stays_off(value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(security.ENABLE, value)
    require('simulator', [])
    assert security.STRATEGY not in os.environ


@pytest.mark.parametrize('value', ['1', 'True', 'TRUE', 'yes', 'on', ' true'])
def test_values_that_ros_reads_as_false_are_refused(
        value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(security.ENABLE, value)
    with pytest.raises(SecurityError, match=r'ROS_SECURITY_ENABLE is .*expected true or false'):
        require('simulator', [])


@pytest.mark.parametrize('strategy', ['', 'Permissive', 'enforce', 'Enforce'])
def test_with_keys_security_is_enforced(
        keystore: Path, strategy: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(security.STRATEGY, strategy)
    require('simulator', [])
    assert os.environ[security.STRATEGY] == 'Enforce'
    assert os.environ[security.OVERRIDE] == '/hoverslam/simulator'


@pytest.mark.parametrize('args', [['--ros-args', '-e', '/mine/a'], ['--enclave', '/mine/a']])
def test_a_named_enclave_is_used(keystore: Path, args: list[str]) -> None:
    with pytest.raises(SecurityError, match=r'enclaves/mine/a lacks identity_ca\.cert\.pem'):
        require('simulator', args)
    (keystore / 'enclaves' / 'hoverslam').rename(keystore / 'enclaves' / 'mine')
    (keystore / 'enclaves' / 'mine' / 'simulator').rename(keystore / 'enclaves' / 'mine' / 'a')
    require('simulator', args)
    assert os.environ[security.OVERRIDE] == '/mine/a'


@pytest.mark.parametrize('name', security.FILES)
def test_an_enclave_that_lacks_a_file_is_refused(keystore: Path, name: str) -> None:
    (keystore / 'enclaves' / 'hoverslam' / 'simulator' / name).unlink()
    with pytest.raises(SecurityError, match=f'hoverslam/simulator lacks {name}; '):
        require('simulator', [])


def test_without_a_keystore(keystore: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(security.KEYSTORE, '')
    with pytest.raises(SecurityError, match='ROS_SECURITY_KEYSTORE is empty'):
        require('simulator', [])
    monkeypatch.setenv(security.KEYSTORE, str(keystore / 'nowhere'))
    with pytest.raises(SecurityError, match='nowhere/enclaves/hoverslam/simulator lacks'):
        require('simulator', [])


def test_a_middleware_without_security(keystore: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(security, 'supported', lambda: False)
    with pytest.raises(SecurityError, match=r'built without DDS-Security: .* or unset'):
        require('simulator', [])


def test_policy_is_of_the_form_that_sros2_reads() -> None:
    """By the rules of `sros2/policy/schemas/policy.xsd`, version 0.2.0."""
    kinds = {
        'topics': ('topic', {'publish', 'subscribe'}),
        'services': ('service', {'reply', 'request'}),
        'actions': ('action', {'call', 'execute'})}
    root = ElementTree.parse(POLICY).getroot()
    assert (root.tag, root.attrib) == ('policy', {'version': '0.2.0'})
    enclaves, = root
    assert enclaves.tag == 'enclaves'
    paths = [enclave.attrib['path'] for enclave in enclaves]
    assert len(set(paths)) == len(paths)
    for enclave in enclaves:
        assert (enclave.tag, set(enclave.attrib)) == ('enclave', {'path'})
        profiles, = enclave
        assert (profiles.tag, profiles.attrib) == ('profiles', {})
        for profile in profiles:
            assert (profile.tag, set(profile.attrib)) == ('profile', {'ns', 'node'})
            assert enclave.attrib['path'] == f'/hoverslam/{profile.attrib["node"]}'
            for rules in profile:
                item, permissions = kinds[rules.tag]
                assert set(rules.attrib) <= permissions
                assert set(rules.attrib.values()) == {'ALLOW'}
                assert len(rules)
                assert {rule.tag for rule in rules} == {item}
                assert all(rule.text for rule in rules)


def test_policy_allows_the_same_in_each_namespace() -> None:
    """Rules of full names hold anywhere and need not be repeated."""
    def rules(profile: ElementTree.Element) -> set[tuple[str, str]]:
        return {(does, str(rule.text)) for group in profile for does in group.attrib
                for rule in group}

    for enclave in ElementTree.parse(POLICY).iter('enclave'):
        root, other = enclave.iter('profile')
        assert (root.attrib['ns'], other.attrib['ns']) == ('/', '/*')
        everywhere, elsewhere = rules(root), rules(other)
        assert {rule for rule in everywhere if not rule[1].startswith('/')} <= elsewhere
        # In the root namespace, a relative name is the full one after its slash.
        assert elsewhere <= everywhere | {
            (does, name.removeprefix('/')) for does, name in everywhere}


@pytest.mark.parametrize(('attempt', 'has_it'), [
    ('pass', False),  # pays no heed to security: made a node from empty keys
    ('raise SystemExit("keys are empty")', True),
    ('raise SystemExit("the context doesn\'t have the security libraries")', False)])
def test_a_middleware_that_accepts_empty_keys_has_no_security(
        attempt: str, has_it: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(security, '_ATTEMPT', attempt)
    assert SUPPORTED() == has_it


def test_an_attempt_that_hangs_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(security, '_ATTEMPT', 'import time; time.sleep(60)')
    monkeypatch.setattr(security, '_PATIENCE', 0.3)
    with pytest.raises(SecurityError, match='try again'):
        SUPPORTED()
