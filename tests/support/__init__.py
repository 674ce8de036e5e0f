# SPDX-License-Identifier: Apache-2.0
"""Helpers of several tests: processes, hosts, forged files, worlds, references."""
