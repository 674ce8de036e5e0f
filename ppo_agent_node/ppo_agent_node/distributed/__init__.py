# SPDX-License-Identifier: Apache-2.0
"""One run trained by several processes, its ranks: collectives, rendezvous, shared flights."""
