# SPDX-License-Identifier: Apache-2.0
"""The scripted pilot that identifies its vehicle in flight."""
