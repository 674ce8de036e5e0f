# SPDX-License-Identifier: Apache-2.0
"""States of rockets over time, from a simulator or from a world in this process."""
