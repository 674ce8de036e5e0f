# SPDX-License-Identifier: Apache-2.0
"""Rerun recordings of flights and trainings: content, layout and storage. No ROS in here."""
import os

# Read when rerun is imported. Suppresses its warning about files without a table of contents,
# which file_sink writes until the end. Other warnings stay.
os.environ.setdefault('RUST_LOG', 'warn,re_log_encoding::rrd::file_sink=error')
