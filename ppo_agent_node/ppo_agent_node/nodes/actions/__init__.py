# SPDX-License-Identifier: Apache-2.0
"""Execution of the actions `train`, `evaluate` and `land` by node `action_server`."""
