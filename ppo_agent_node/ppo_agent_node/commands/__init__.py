# SPDX-License-Identifier: Apache-2.0
"""Commands that fly in this process and write files: compare, failures, pictures, report."""
