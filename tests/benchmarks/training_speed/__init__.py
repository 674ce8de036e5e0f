# SPDX-License-Identifier: Apache-2.0
"""Speed of a training over DDS: parts of a step, simulators, learners and recorders."""
