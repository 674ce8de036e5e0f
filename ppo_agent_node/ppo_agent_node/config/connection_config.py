# SPDX-License-Identifier: Apache-2.0
"""How an agent reaches its simulators: the settings, without ROS."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rocket_sim_node.settings import setting

SECOND = 'simulator_2'
"""Namespace, below that of the agent, of the second simulator that `train` starts."""


def simulators_setting() -> Any:
    """Declare the setting that names the simulators of a training."""
    return setting(
        '', '', "namespaces of the simulators to train in, such as /sim_*; simulators may join "
        "later; {rank} stands for the rank of this agent. Empty: the simulator in the agent's own "
        'namespace')


@dataclass(frozen=True)
class ConnectionConfig:
    """How long to wait for the simulator."""

    resend_after: float = setting(
        0.2, 's', 'time without an answer after which an action is sent again', 0.001, 60.0)
    patience: float = setting(
        60.0, 's', 'time without an answer after which the node gives up', 0.1, 1e6)
    acknowledge: str = setting(
        'auto', '', 'whether observations and rewards are acknowledged, so that DDS repeats lost '
        'ones; auto: if the discovery range extends beyond this machine or they are large for the '
        'receive buffer',
        choices=('auto', 'always', 'never'))


@dataclass(frozen=True)
class FleetConfig(ConnectionConfig):
    """How a training finds and reaches its simulators."""

    simulators: str = simulators_setting()
