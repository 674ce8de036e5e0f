# SPDX-License-Identifier: Apache-2.0
"""Fast DDS: transport, security, quality of service and shared-memory clean-up."""
