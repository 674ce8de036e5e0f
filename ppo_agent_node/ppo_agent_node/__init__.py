# SPDX-License-Identifier: Apache-2.0
"""Pilots, learning, evaluation and their nodes."""
import os

# Threads of the tensor library that wait must sleep. By default (libgomp's) they spin, and with
# as many threads as cores and a simulator beside them the whole line runs 4 to 80 times slower.
# It is read once, when torch is first imported, which modules of this package do.
os.environ.setdefault('OMP_WAIT_POLICY', 'PASSIVE')
# What is not said otherwise, see `threads`.
os.environ.setdefault('OMP_NUM_THREADS', '1')
