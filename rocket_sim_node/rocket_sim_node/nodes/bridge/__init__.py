# SPDX-License-Identifier: Apache-2.0
"""Parts of node `ros_bridge`: standard messages from plain values, and their publishers."""
