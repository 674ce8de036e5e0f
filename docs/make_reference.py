# SPDX-License-Identifier: Apache-2.0
"""Writes the generated pages of docs/reference: `python docs/make_reference.py`.

Run it with the environment active (`. launch_scripts/env.sh`), after any change of a command, a
parameter, a message, a topic or a public name. A test says when a page is stale.
"""
from __future__ import annotations

import importlib
from pathlib import Path

FOLDER = Path(__file__).parent / 'reference'
PAGES = {
    'commands.md': 'commands', 'nodes-and-topics.md': 'nodes_and_topics',
    'parameters.md': 'parameters', 'python-api.md': 'python_api'}
"""Pages, and the modules of `reference_pages` that return their text."""
_NOTE = (
    '<!-- Written from the code by docs/make_reference.py. Do not edit it: change the code, or '
    'docs/reference_pages/{module}.py, and run `python docs/make_reference.py`. -->\n\n')


def page(name: str) -> str:
    """Return what a page ought to hold."""
    module = PAGES[name]
    text: str = importlib.import_module(f'reference_pages.{module}').text()
    return _NOTE.format(module=module) + text


def main() -> None:
    """Write all pages."""
    for name in PAGES:
        (FOLDER / name).write_text(page(name), 'utf-8')


if __name__ == '__main__':
    main()
