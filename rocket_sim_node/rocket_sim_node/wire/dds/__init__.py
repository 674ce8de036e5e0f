# SPDX-License-Identifier: Apache-2.0
"""How Fast DDS is set up, secured and cleaned up after."""
