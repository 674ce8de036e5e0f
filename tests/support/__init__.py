# SPDX-License-Identifier: Apache-2.0
"""What several tests share: processes, hosts, forged files, worlds, references."""
