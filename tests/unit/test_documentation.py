# SPDX-License-Identifier: Apache-2.0
"""What the documents say is what the code says."""
from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ('rocket_msgs', 'rocket_sim_node', 'ppo_agent_node')


def test_the_list_of_parameters_is_current() -> None:
    module = runpy.run_path(str(ROOT / 'docs' / 'make_parameters.py'))
    assert (ROOT / 'docs' / 'parameters.md').read_text() == module['text'](), (
        'run: python docs/make_parameters.py')


@pytest.mark.parametrize('page', ['README.md', *(
    f'docs/{path.name}' for path in (ROOT / 'docs').glob('*.md'))])
def test_links_lead_somewhere(page: str) -> None:
    text = (ROOT / page).read_text()
    for target in re.findall(r'\]\(([^)#:]+)\)', text):
        assert (ROOT / page).parent.joinpath(target).exists(), target


def test_all_packages_have_one_version() -> None:
    versions = {
        package: re.search(r'<version>(.*)</version>', (
            ROOT / package / 'package.xml').read_text())[1]
        for package in PACKAGES}
    versions |= {
        f'{package}/setup.py': re.search(
            r"version='(.*)'", (ROOT / package / 'setup.py').read_text())[1]
        for package in PACKAGES[1:]}
    assert len(set(versions.values())) == 1, versions


@pytest.mark.parametrize('package', PACKAGES)
def test_messages_of_the_readme_exist(package: str) -> None:
    assert f'`{package}`' in (ROOT / 'README.md').read_text()


def test_every_source_file_names_its_licence() -> None:
    missing = [
        str(path.relative_to(ROOT))
        for folder in (*PACKAGES, 'launch_scripts', 'tests', 'docs')
        for path in (ROOT / folder).rglob('*')
        if path.suffix in ('.py', '.sh', '.msg', '.srv', '.xml', '.cfg', '.yaml')
        and 'SPDX-License-Identifier: Apache-2.0' not in path.read_text()[:200]]
    assert not missing
