# SPDX-License-Identifier: Apache-2.0
"""What a recording of flights and training holds, and how it looks. No ROS in here."""
import os

# Read when rerun is imported. It warns of files without a table of contents, which is what
# file_sink writes until the end. Of other things it warns as before.
os.environ.setdefault('RUST_LOG', 'warn,re_log_encoding::rrd::file_sink=error')
