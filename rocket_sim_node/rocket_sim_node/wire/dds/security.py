# SPDX-License-Identifier: Apache-2.0
"""Security that was asked for is there, or no node starts.

ROS 2 secures a node when `ROS_SECURITY_ENABLE` is `true` and says nothing when it then runs
without: in strategy `Permissive`, the default, when it finds no keys; in either when the variable
holds anything but `true`, such as `1`. Here whoever asks for security gets it or an error.
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
"""below it each node has an enclave of its own, see launch_scripts/security"""
FILES = (
    'identity_ca.cert.pem', 'cert.pem', 'key.pem', 'permissions_ca.cert.pem', 'governance.p7s',
    'permissions.p7s')
"""of an enclave: without one of them a middleware may go on unsecured"""
_ADVICE = (
    'install a ROS 2 that has it (a distribution with ros-<distro>-sros2; the wheels lack it) and '
    f'use ./launch_scripts/secure, or unset {ENABLE} to run unsecured')
_LACKING = ("doesn't have the security libraries", 'does not have security support')
"""what Fast DDS and Cyclone DDS say when they were built without security"""
_ATTEMPT = """
import rclpy
rclpy.init()
rclpy.create_node('attempt')
"""
_PATIENCE = 60.0
"""s for the attempt"""


class SecurityError(Exception):
    """Security was asked for and cannot be had."""


def requested() -> bool:
    """Return whether security was asked for.

    :raises SecurityError: when the variable says neither yes nor no; ROS 2 would take it for no.
    """
    value = os.environ.get(ENABLE, '')
    if value not in ('', 'true', 'false'):
        raise SecurityError(
            f'{ENABLE} is {value!r}, expected true or false: ROS 2 would run unsecured')
    return value == 'true'


def supported() -> bool:
    """Return whether the middleware in use was built with DDS-Security.

    It only tells when it is to use it: another process has it try, with an enclave of empty files.
    """
    with tempfile.TemporaryDirectory() as folder:
        enclave = Path(folder) / 'enclaves' / 'attempt'
        enclave.mkdir(parents=True)
        for name in FILES:
            (enclave / name).touch()
        try:
            told = subprocess.run(
                [sys.executable, '-c', _ATTEMPT], capture_output=True, text=True, errors='replace',
                timeout=_PATIENCE, check=False, env={
                    **os.environ, ENABLE: 'true', STRATEGY: 'Enforce', KEYSTORE: folder,
                    OVERRIDE: '/attempt'})
        except subprocess.TimeoutExpired as error:
            raise SecurityError(
                'whether the middleware of this ROS 2 has DDS-Security was not to be found out in '
                f'{_PATIENCE:g} s: try again') from error
    # Who secures refuses empty keys; who takes them pays no heed to them.
    return told.returncode != 0 and not any(
        words in told.stdout + told.stderr for words in _LACKING)


def require(node: str, args: Sequence[str]) -> None:
    """Make sure that a node of this process is secured, when this was asked for.

    A node for which no enclave is named gets its own.

    :param args: of the command line.
    :raises SecurityError: saying why it cannot be secured, and what to do.
    """
    if not requested():
        return
    if not supported():
        raise SecurityError(
            f'security was asked for ({ENABLE}=true), but the middleware of this ROS 2 was built '
            f'without DDS-Security: {_ADVICE}')
    enclave = os.environ.get(OVERRIDE) or _named(args) or f'{ENCLAVES}/{node}'
    keystore = os.environ.get(KEYSTORE, '')
    if not keystore:
        raise SecurityError(
            f'security was asked for ({ENABLE}=true), but {KEYSTORE} is empty, expected the '
            'folder of the keys; ./launch_scripts/secure makes them')
    folder = Path(keystore) / 'enclaves' / enclave.strip('/')
    missing = [name for name in FILES if not (folder / name).is_file()]
    if missing:
        raise SecurityError(
            f'security was asked for ({ENABLE}=true), but {folder} lacks {", ".join(missing)}; '
            './launch_scripts/secure makes the keys of all nodes')
    os.environ[OVERRIDE] = enclave
    # With these files there both strategies secure; this one does not go on when they fail.
    os.environ[STRATEGY] = 'Enforce'


def _named(args: Sequence[str]) -> str:
    """Return the enclave that a command line names."""
    for flag, value in zip(args, args[1:], strict=False):
        if flag in ('-e', '--enclave'):
            return value
    return ''


def main() -> int:
    """Say whether security can be had, for scripts."""
    if supported():
        return 0
    sys.stderr.write(f'the middleware of this ROS 2 was built without DDS-Security: {_ADVICE}\n')
    return 2


if __name__ == '__main__':
    sys.exit(main())
