# SPDX-License-Identifier: Apache-2.0
"""One module for each command of ros2, named after it; `launch` has a folder of its own."""
