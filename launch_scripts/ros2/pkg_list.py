# SPDX-License-Identifier: Apache-2.0
"""Output a list of available packages."""
from __future__ import annotations

import argparse

from ros2 import packages


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """There are no options."""


def main(args: argparse.Namespace) -> None:
    """Print one package a line."""
    for name in packages.names():
        print(name)
