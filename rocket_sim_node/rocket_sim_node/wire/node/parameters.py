# SPDX-License-Identifier: Apache-2.0
"""ROS parameters from settings: declared with description and range, validated, read-only."""
from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Mapping
from typing import Any
from typing import TypeVar

from rcl_interfaces.msg import FloatingPointRange
from rcl_interfaces.msg import IntegerRange
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

from rocket_sim_node import settings
from rocket_sim_node.settings import SettingInfo

S = TypeVar('S')

_OWN = ('use_sim_time', 'start_type_description_service')
_OWN_PREFIXES = ('qos_overrides.',)


class ParameterError(ValueError):
    """A parameter is unknown, of the wrong type or out of range; the message names it."""


class Parameters:
    """Declares a node's parameters and detects overrides that were not declared.

    The node must have been created with `automatically_declare_parameters_from_overrides=True`:
    otherwise ROS silently drops undeclared, and thus misspelt, parameters.
    """

    def __init__(self, node: Node) -> None:
        """Record the overrides given to `node`."""
        self._node = node
        self.given = {
            name: parameter.value
            for name, parameter in node.get_parameters_by_prefix('').items()
            if name not in _OWN and not name.startswith(_OWN_PREFIXES)
        }
        self._known: list[str] = []
        for name in self.given:
            node.undeclare_parameter(name)

    def declare(self, cls: type[S]) -> S:
        """Declare each field of a settings dataclass as a parameter; return the filled dataclass.

        :raises ParameterError: for a value of the wrong type or out of range.
        """
        return settings.build(cls, self.declare_infos(settings.describe(cls)))

    def declare_infos(
        self, infos: Iterable[SettingInfo], defaults: Mapping[str, Any] | None = None,
    ) -> dict[str, Any]:
        """Declare single settings and return their values by name.

        :param defaults: replacements for the settings' own defaults, e.g. from a preset.
        :raises ParameterError: for a value of the wrong type or out of range.
        """
        return {
            info.name: self._declare(info, (defaults or {}).get(info.name, info.default))
            for info in infos
        }

    def _declare(self, info: SettingInfo, default: Any) -> Any:
        self._known.append(info.name)
        value = self.given.get(info.name, default)
        try:
            value = settings.check(info, value)
        except (ValueError, TypeError) as error:
            raise ParameterError(f'parameter {error}') from error
        sent = list(value) if isinstance(value, tuple) else value
        # Otherwise the override (2) would replace the validated value (2.0).
        self._node.declare_parameter(
            info.name, sent, _descriptor(info), ignore_override=True)
        return value

    def finish(self) -> None:
        """Check that every override was declared.

        :raises ParameterError: naming unknown parameters and the known ones.
        """
        unknown = sorted(set(self.given) - set(self._known))
        if unknown:
            raise ParameterError(
                f'unknown parameter {", ".join(map(repr, unknown))}, '
                f'expected {", ".join(self._known)}')


def _descriptor(info: SettingInfo) -> ParameterDescriptor:
    description = info.description + (f' ({info.unit})' if info.unit else '')
    descriptor = ParameterDescriptor(
        description=description, read_only=True,
        additional_constraints=', '.join(choice or "''" for choice in info.choices))
    if isinstance(info.default, bool | str):
        return descriptor
    if isinstance(info.default, float):
        descriptor.floating_point_range = [FloatingPointRange(
            from_value=float(max(info.low, -1e300)),
            to_value=float(min(info.high, 1e300)))]
    elif isinstance(info.default, int):
        limit = 2**63 - 1
        descriptor.integer_range = [IntegerRange(
            from_value=int(max(info.low, -limit)), to_value=int(min(info.high, limit)))]
    return descriptor
