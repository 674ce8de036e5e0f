# SPDX-License-Identifier: Apache-2.0
"""What a person needs who flies: keys, instruments, a display, a debriefing."""
