# SPDX-License-Identifier: Apache-2.0
"""World `rocket`: the vehicle, how it flies, where it begins and how an episode ends."""
