# SPDX-License-Identifier: Apache-2.0
"""The agent's side of the protocol: a client for one simulator, and for a fleet of them."""
