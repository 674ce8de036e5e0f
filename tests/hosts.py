# SPDX-License-Identifier: Apache-2.0
"""Two hosts on one machine: network namespaces, joined by a virtual cable."""
from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

from processes import Process
from processes import Processes


def missing() -> str:
    """Return why there can be no hosts here; empty when there can."""
    if shutil.which('ip') is None:
        return 'no command ip (package iproute2)'
    name = f'hoverslam-{os.getpid()}-probe'
    try:
        _ip('netns', 'add', name)
        _ip('-n', name, 'link', 'add', 'probe0', 'type', 'veth', 'peer', 'name', 'probe1')
    except subprocess.CalledProcessError as error:
        return f'no network namespaces: {error.stderr.strip()}'
    finally:
        subprocess.run(['ip', 'netns', 'del', name], check=False, capture_output=True)
    return ''


def _ip(*arguments: str) -> None:
    subprocess.run(['ip', *arguments], check=True, capture_output=True, text=True, timeout=10)


class Hosts(Processes):
    """Processes on two hosts, 0 and 1, which reach each other and nobody else."""

    def __init__(self, folder: Path) -> None:
        """Make the namespaces and the cable."""
        super().__init__(folder)
        self._names = [f'hoverslam-{os.getpid()}-{number}' for number in range(2)]
        ends = [f'hs{os.getpid() % 100_000}{side}' for side in 'ab']
        try:
            for name in self._names:
                _ip('netns', 'add', name)
            _ip('link', 'add', ends[0], 'type', 'veth', 'peer', 'name', ends[1])
            for number, (name, end) in enumerate(zip(self._names, ends, strict=True)):
                _ip('link', 'set', end, 'netns', name)
                for command in (
                    ('addr', 'add', f'10.213.7.{number + 1}/24', 'dev', end),
                    ('link', 'set', end, 'up'), ('link', 'set', 'lo', 'up'),
                    ('route', 'add', 'default', 'dev', end),
                ):
                    _ip('-n', name, *command)
        except BaseException:
            self.end()
            raise

    @property
    def env(self) -> dict[str, str]:
        """Environment of the processes: peers on the same network are discovered."""
        return {**super().env, 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'}

    def on(self, host: int) -> Processes:
        """Return what starts processes on a host."""
        return _Host(self, ('ip', 'netns', 'exec', self._names[host]))

    def end(self) -> None:
        """End all processes and take the hosts away."""
        super().end()
        for name in self._names:
            subprocess.run(['ip', 'netns', 'del', name], check=False, capture_output=True)


class _Host(Processes):
    """One host's view: what it starts is ended with the others."""

    def __init__(self, hosts: Hosts, prefix: tuple[str, ...]) -> None:
        self._hosts, self._prefix = hosts, prefix

    def start(self, *command: str) -> Process:
        """Start a process on this host."""
        return self._hosts.start(*self._prefix, *command)
