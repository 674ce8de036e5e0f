# SPDX-License-Identifier: Apache-2.0
"""Commands: how train, land, evaluate and fly begin; compare, failures, pictures and report."""
