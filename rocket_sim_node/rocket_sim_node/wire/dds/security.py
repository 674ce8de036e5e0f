# SPDX-License-Identifier: Apache-2.0
"""Check that DDS-Security, when requested, is in effect before a node starts.

ROS 2 secures a node when `ROS_SECURITY_ENABLE` is `true`, but silently runs without security in
two cases: in strategy `Permissive`, the default, when it finds no keys; and in either strategy
when the variable holds anything but `true`, such as `1`. Here, a request for security either
succeeds or raises an error.
"""
from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

ENABLE, STRATEGY = 'ROS_SECURITY_ENABLE', 'ROS_SECURITY_STRATEGY'
KEYSTORE, OVERRIDE = 'ROS_SECURITY_KEYSTORE', 'ROS_SECURITY_ENCLAVE_OVERRIDE'
ENCLAVES = '/hoverslam'
"""Parent of the enclaves, one for each node; see launch_scripts/security."""
FILES = (
    'identity_ca.cert.pem', 'cert.pem', 'key.pem', 'permissions_ca.cert.pem', 'governance.p7s',
    'permissions.p7s')
"""Files of an enclave; without one of them a middleware may continue unsecured."""
_ADVICE = (
    'install a ROS 2 that has it (a distribution with ros-<distro>-sros2; the wheels lack it) and '
    f'use ./launch_scripts/secure, or unset {ENABLE} to run unsecured')
_LACKING = ("doesn't have the security libraries", 'does not have security support')
"""Error messages of Fast DDS and Cyclone DDS when built without security."""
_ATTEMPT = """
import rclpy
rclpy.init()
rclpy.create_node('attempt')
"""
_PATIENCE = 60.0
"""Time limit of the check in a subprocess, s."""


class SecurityError(Exception):
    """Security was requested and is not available."""


def requested() -> bool:
    """Return whether security was requested.

    :raises SecurityError: when the variable is neither yes nor no; ROS 2 would read it as no.
    """
    value = os.environ.get(ENABLE, '')
    if value not in ('', 'true', 'false'):
        raise SecurityError(
            f'{ENABLE} is {value!r}, expected true or false: ROS 2 would run unsecured')
    return value == 'true'


def supported() -> bool:
    """Return whether the middleware in use was built with DDS-Security.

    It can only be found out by using it, so a subprocess tries with an enclave of empty files.
    """
    with tempfile.TemporaryDirectory() as folder:
        enclave = Path(folder) / 'enclaves' / 'attempt'
        enclave.mkdir(parents=True)
        for name in FILES:
            (enclave / name).touch()
        try:
            answer = subprocess.run(
                [sys.executable, '-c', _ATTEMPT], capture_output=True, text=True, errors='replace',
                timeout=_PATIENCE, check=False, env={
                    **os.environ, ENABLE: 'true', STRATEGY: 'Enforce', KEYSTORE: folder,
                    OVERRIDE: '/attempt'})
        except subprocess.TimeoutExpired as error:
            raise SecurityError(
                f'it took more than {_PATIENCE:g} s to find out whether the middleware of this '
                'ROS 2 has DDS-Security: try again') from error
    # A secured middleware rejects empty keys; one without security ignores them.
    return answer.returncode != 0 and not any(
        words in answer.stdout + answer.stderr for words in _LACKING)


def require(node: str, args: Sequence[str]) -> None:
    """Ensure that this process's node is secured, if security was requested.

    A node without an explicit enclave gets its own.

    :param args: command-line arguments.
    :raises SecurityError: with the reason and a remedy.
    """
    if not requested():
        return
    if not supported():
        raise SecurityError(
            f'security was requested ({ENABLE}=true), but the middleware of this ROS 2 was built '
            f'without DDS-Security: {_ADVICE}')
    enclave = os.environ.get(OVERRIDE) or _named(args) or f'{ENCLAVES}/{node}'
    keystore = os.environ.get(KEYSTORE, '')
    if not keystore:
        raise SecurityError(
            f'security was requested ({ENABLE}=true), but {KEYSTORE} is empty, expected the '
            'folder of the keys; ./launch_scripts/secure makes them')
    folder = Path(keystore) / 'enclaves' / enclave.strip('/')
    missing = [name for name in FILES if not (folder / name).is_file()]
    if missing:
        raise SecurityError(
            f'security was requested ({ENABLE}=true), but {folder} lacks {", ".join(missing)}; '
            './launch_scripts/secure makes the keys of all nodes')
    os.environ[OVERRIDE] = enclave
    # With all files present both strategies secure the node; Enforce also stops when that fails.
    os.environ[STRATEGY] = 'Enforce'


def _named(args: Sequence[str]) -> str:
    """Return the enclave named on a command line."""
    for flag, value in zip(args, args[1:], strict=False):
        if flag in ('-e', '--enclave'):
            return value
    return ''


def main() -> int:
    """Print whether security is available, for scripts."""
    if supported():
        return 0
    sys.stderr.write(f'the middleware of this ROS 2 was built without DDS-Security: {_ADVICE}\n')
    return 2


if __name__ == '__main__':
    sys.exit(main())
