# SPDX-License-Identifier: Apache-2.0
"""Policies for other programs: ONNX files and model cards."""
