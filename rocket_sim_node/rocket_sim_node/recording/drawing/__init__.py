# SPDX-License-Identifier: Apache-2.0
"""What scenes and plots are drawn with: colours, meshes, entities, views, curves."""
