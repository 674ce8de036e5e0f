# SPDX-License-Identifier: Apache-2.0
"""Speed of a training over DDS: its parts, simulators, learners and recorder."""
