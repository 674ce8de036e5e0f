# SPDX-License-Identifier: Apache-2.0
"""Conversion of a message of `training` to the report that it carries."""
from __future__ import annotations

from rocket_msgs.msg import TrainingStatus

from rocket_sim_node.printable import printable
from rocket_sim_node.telemetry.training_status import Status


def status_from_message(message: TrainingStatus) -> Status:
    """Return the report in a message, with non-printable characters removed."""
    values = {name: getattr(message, name) for name in Status.__dataclass_fields__}
    words = {name: printable(value) for name, value in values.items() if isinstance(value, str)}
    return Status(**{**values, **words, 'stages': tuple(map(printable, message.stages))})
