# SPDX-License-Identifier: Apache-2.0
"""Commands that fly in this process or write files: compare, failures, pictures, report."""
