# SPDX-License-Identifier: Apache-2.0
"""Pilots, learning, evaluation and their nodes."""
import os

__version__ = '1.0.0'
"""The same as in package.xml and setup.py, here also where the package is not installed."""

# Waiting threads of the tensor library must sleep. By default (libgomp's) they spin, and with as
# many threads as cores and a simulator beside them, everything runs 4 to 80 times slower.
# The variable is read once, when torch is first imported, by modules of this package.
os.environ.setdefault('OMP_WAIT_POLICY', 'PASSIVE')
# The default, unless `threads` says otherwise.
os.environ.setdefault('OMP_NUM_THREADS', '1')
