# SPDX-License-Identifier: Apache-2.0
"""How each world looks in the viewer."""
