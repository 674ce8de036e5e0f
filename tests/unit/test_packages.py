# SPDX-License-Identifier: Apache-2.0
"""Metadata of the packages, and the dependencies of a user who only simulates."""
from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ('rocket_msgs', 'rocket_sim_node', 'ppo_agent_node')


def described(package: str, tag: str) -> str:
    """Return the text of an element of a package's package.xml."""
    return ElementTree.parse(ROOT / package / 'package.xml').findtext(tag, '')


@pytest.mark.parametrize('package', PACKAGES)
def test_a_manifest_is_valid_and_names_each_dependency_once(package: str) -> None:
    """By the rules of package_format3.xsd that matter here; ament_xmllint needs the network."""
    root = ElementTree.parse(ROOT / package / 'package.xml').getroot()
    assert (root.tag, root.get('format')) == ('package', '3')
    tags = [child.tag for child in root]
    assert tags[:4] == ['name', 'version', 'description', 'maintainer'] and 'license' in tags
    assert root.findtext('name') == package
    depends = [(child.tag, child.text) for child in root if child.tag.endswith('depend')]
    assert len(set(depends)) == len(depends)
    assert all(re.fullmatch('[a-z0-9_-]+', str(name)) for _, name in depends)
    assert root.find('export/build_type') is not None


@pytest.mark.parametrize('package', PACKAGES[1:])
def test_a_manifest_names_the_ros_packages_that_its_code_imports(package: str) -> None:
    root = ElementTree.parse(ROOT / package / 'package.xml').getroot()
    named = {child.text for child in root if child.tag.endswith('depend')}
    known = {'rclpy', 'rocket_msgs', 'rocket_sim_node', 'ament_index_python'} | {
        str(name) for name in named if str(name).endswith(('_msgs', '_interfaces'))}
    imported = {
        found for path in (ROOT / package / package).rglob('*.py')
        for found in re.findall(r'^ *(?:from|import) (\w+)', path.read_text(), re.MULTILINE)
        if found in known or found.endswith(('_msgs', '_interfaces'))} - {package}
    assert imported <= named, imported - named


@pytest.mark.parametrize('package', PACKAGES)
def test_a_package_has_a_changelog_and_our_licence(package: str) -> None:
    assert package in (ROOT / package / 'CHANGELOG.rst').read_text()
    assert described(package, 'license') == 'Apache-2.0'


@pytest.mark.parametrize('node', ['simulator', 'ros_bridge'])
def test_a_simulation_needs_neither_the_recorder_nor_learning(node: str) -> None:
    pytest.importorskip('rclpy')
    absent = 'rerun', 'pyarrow', 'mcap', 'torch', 'matplotlib'
    program = (f'import sys; sys.modules.update(dict.fromkeys({absent!r})); '
               f'import rocket_sim_node.nodes.{node}')
    done = subprocess.run(
        [sys.executable, '-c', program], capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stderr


def test_both_packages_start_the_simulator_with_the_same_parameters() -> None:
    """Each is released alone, so each has the file."""
    one, other = (
        (ROOT / package / 'launch/parameters/simulator.yaml') for package in PACKAGES[1:])
    assert not one.is_symlink() and not other.is_symlink()
    assert one.read_text() == other.read_text()
