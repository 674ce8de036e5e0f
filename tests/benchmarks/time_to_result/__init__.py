# SPDX-License-Identifier: Apache-2.0
"""Time from the start of the processes to a passing evaluation, ours and of peers."""
