# SPDX-License-Identifier: Apache-2.0
"""Two hosts on one machine, and what happens between them: delays, losses, intruders."""
