# SPDX-License-Identifier: Apache-2.0
"""Pilots, learning, evaluation and their nodes."""
import os

__version__ = '1.0.0'
"""The same as in package.xml and setup.py, here also where the package is not installed."""

# Threads of the tensor library (libgomp) that wait spin for about 0.1 ms and then sleep. Without
# spinning, cloning with two threads is no faster than with one. By default they spin for
# milliseconds, and with as many threads as cores and a simulator beside them, everything runs 4 to
# 80 times slower. The variables are read once, when torch is first imported, by modules of this
# package. Where GOMP_SPINCOUNT is unknown, waiting threads sleep.
os.environ.setdefault('OMP_WAIT_POLICY', 'PASSIVE')
os.environ.setdefault('GOMP_SPINCOUNT', '3000')
# The default, unless `threads` says otherwise.
os.environ.setdefault('OMP_NUM_THREADS', '1')
