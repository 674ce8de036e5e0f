# SPDX-License-Identifier: Apache-2.0
"""Two hosts on one machine, with delays and losses on their link, and intruders."""
