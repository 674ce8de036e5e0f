# SPDX-License-Identifier: Apache-2.0
"""World `lunar_lander`: Gymnasium's LunarLander rebuilt on pymunk."""
