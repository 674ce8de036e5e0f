# SPDX-License-Identifier: Apache-2.0
"""Two hosts on one machine: network namespaces, joined by a virtual cable."""
from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

from support.processes import Process
from support.processes import Processes


def missing() -> str:
    """Return the reason why no hosts can be made here, or an empty string."""
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


def missing_loss() -> str:
    """Return the reason why hosts here cannot lose packets, or an empty string."""
    if why := missing():
        return why
    if shutil.which('nft') is None:
        return 'no command nft (package nftables)'
    name = f'hoverslam-{os.getpid()}-probe'
    try:
        _ip('netns', 'add', name)
        _ip('netns', 'exec', name, 'nft', _LOSS.format(per_mille=1))
    except subprocess.CalledProcessError as error:
        return f'no packets can be lost: {error.stderr.strip()}'
    finally:
        subprocess.run(['ip', 'netns', 'del', name], check=False, capture_output=True)
    return ''


_LOSS = (
    'table inet hoverslam {{ chain arriving {{ type filter hook input priority 0; '
    'iifname != "lo" counter numgen random mod 1000 < {per_mille} counter drop; }}; }}')
"""Rules of nftables, because few kernels of virtual machines have netem."""


def _ip(*arguments: str) -> None:
    subprocess.run(['ip', *arguments], check=True, capture_output=True, text=True, timeout=10)


class Hosts(Processes):
    """Processes on two hosts, 0 and 1, which reach each other and no other host."""

    def __init__(self, folder: Path) -> None:
        """Make the namespaces and the virtual cable."""
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
                    ('addr', 'add', f'{self.address(number)}/24', 'dev', end),
                    ('link', 'set', end, 'up'), ('link', 'set', 'lo', 'up'),
                    ('route', 'add', 'default', 'dev', end),
                ):
                    _ip('-n', name, *command)
        except BaseException:
            self.end()
            raise

    def lose(self, share: float) -> None:
        """Drop a random share of the packets that arrive at either host."""
        for name in self._names:
            _ip('netns', 'exec', name, 'nft', _LOSS.format(per_mille=round(1000 * share)))

    def lost(self) -> tuple[int, int]:
        """Return the numbers of packets that arrived at both hosts and that were dropped there."""
        arrived = lost = 0
        for name in self._names:
            rules = json.loads(subprocess.run(
                ['ip', 'netns', 'exec', name, 'nft', '-j', 'list', 'ruleset'],
                check=True, capture_output=True, text=True, timeout=10).stdout)['nftables']
            all_of_them, dropped = (
                part['counter']['packets'] for rule in rules if 'rule' in rule
                for part in rule['rule']['expr'] if 'counter' in part)
            arrived, lost = arrived + all_of_them, lost + dropped
        return arrived, lost

    @property
    def env(self) -> dict[str, str]:
        """Environment of the processes: peers on the same network are discovered."""
        return {**super().env, 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'}

    def on(self, host: int, **variables: str | None) -> Processes:
        """Return an object that starts processes on a host.

        :param variables: environment variables in addition to `env`; None: unset the variable.
        """
        changes = [
            *(word for name, value in variables.items() if value is None for word in ('-u', name)),
            *(f'{name}={value}' for name, value in variables.items() if value is not None)]
        return _Host(self, ('ip', 'netns', 'exec', self._names[host], 'env', *changes))

    def delay(self, milliseconds: float) -> None:
        """Make a second link, with other addresses and a one-way delay."""
        link = self.start(
            sys.executable, '-m', 'support.network.delayed_link', *self._names,
            *map(self.far_address, range(2)), str(milliseconds))
        link.wait_for('ready', 20.0)

    @staticmethod
    def address(host: int) -> str:
        """Return the address of a host."""
        return f'10.213.7.{host + 1}'

    @staticmethod
    def far_address(host: int) -> str:
        """Return the address of a host on the delayed link."""
        return f'10.213.8.{host + 1}'

    def end(self) -> None:
        """End all processes and remove the hosts."""
        super().end()
        for name in self._names:
            subprocess.run(['ip', 'netns', 'del', name], check=False, capture_output=True)


class _Host(Processes):
    """Starts processes on one host; `Hosts` ends them."""

    def __init__(self, hosts: Hosts, prefix: tuple[str, ...]) -> None:
        self._hosts, self._prefix = hosts, prefix

    def start(self, *command: str) -> Process:
        """Start a process on this host."""
        return self._hosts.start(*self._prefix, *command)

    fork_node = Processes.run_node  # a fork would be on the host of the tests
