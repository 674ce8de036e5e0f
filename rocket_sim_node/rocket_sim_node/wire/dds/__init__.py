# SPDX-License-Identifier: Apache-2.0
"""Fast DDS: transport, security and quality of service."""
