# SPDX-License-Identifier: Apache-2.0
"""Reports: pictures and pages of runs and evaluations, made from their files alone."""
