# SPDX-License-Identifier: Apache-2.0
"""The picture of each experiment."""
