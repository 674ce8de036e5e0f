# SPDX-License-Identifier: Apache-2.0
"""Complete trainings with several seeds, of presets and of the examples in docs/examples."""
