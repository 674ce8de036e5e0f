# SPDX-License-Identifier: Apache-2.0
"""The documents agree with the code."""
from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

import make_reference
from ppo_agent_node.config.presets import preset_names
from rocket_sim_node.recording.reader import trajectories

ROOT = Path(__file__).parents[2]
PACKAGES = ('rocket_msgs', 'rocket_sim_node', 'ppo_agent_node')
PAGES = (
    ROOT / 'README.md', ROOT / 'CONTRIBUTING.md', ROOT / 'CHANGELOG.md',
    *sorted((ROOT / 'docs').rglob('*.md')))
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]
FENCED = re.compile(r'^```.*?^```', re.MULTILINE | re.DOTALL)
SOURCES = (*PACKAGES, 'launch_scripts', 'tests', 'docs')
ENDINGS = ('.py', '.msg', '.srv', '.action', '.xml', '.sh')
GENERATED = tuple(make_reference.PAGES)
INVENTED = {
    'my_pilot.py', 'DEFAULT_FASTDDS_PROFILES.xml', 'DEFAULT_FASTRTPS_PROFILES.xml'}
"""Files of the reader's."""


def headings(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub names them."""
    found: dict[str, int] = {}
    anchors = set()
    for title in re.findall(r'^#+ (.*)$', FENCED.sub('', page.read_text()), re.MULTILINE):
        plain = re.sub(r'\[([^]]*)\]\([^)]*\)', r'\1', title).strip().lower()
        anchor = re.sub(r'[^\w\- ]', '', plain).replace(' ', '-')
        count = found[anchor] = found.get(anchor, -1) + 1
        anchors.add(f'{anchor}-{count}' if count else anchor)
    return anchors


def blocks(page: Path, language: str) -> list[str]:
    """Return the code of a page in a language."""
    return re.findall(rf'^```{language}\n(.*?)^```', page.read_text(), re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize('name', GENERATED)
def test_a_generated_page_is_current(name: str) -> None:
    assert (ROOT / 'docs' / 'reference' / name).read_text() == make_reference.page(name), (
        'stale; run: python docs/make_reference.py')


@pytest.mark.parametrize('page', PAGES, ids=NAMES)
def test_links_and_anchors_lead_somewhere(page: Path) -> None:
    for target in re.findall(r'\]\(([^)\s]+)\)', FENCED.sub('', page.read_text())):
        if re.match(r'[a-z]+:', target):
            continue
        path, _, anchor = target.partition('#')
        found = page.parent.joinpath(path).resolve() if path else page
        assert found.exists(), target
        if anchor:
            assert anchor in headings(found), target


def test_every_page_can_be_reached_from_the_readme() -> None:
    reached, todo = set(), [ROOT / 'README.md']
    while todo:
        page = todo.pop()
        if page in reached:
            continue
        reached.add(page)
        for target in re.findall(r'\]\(([^)#\s:]+\.md)', page.read_text()):
            todo.append(page.parent.joinpath(target).resolve())
    assert set(PAGES) <= reached


def test_every_picture_is_shown() -> None:
    shown = {
        page.parent.joinpath(target).resolve() for page in PAGES
        for target in re.findall(r'!\[[^]]*\]\(([^)]+)\)', page.read_text())}
    assert set((ROOT / 'docs' / 'images').iterdir()) == shown


@pytest.mark.parametrize('page', PAGES, ids=NAMES)
def test_the_files_that_a_page_names_exist(page: Path) -> None:
    """Programs, launch files and messages, by path or by the end of it."""
    known = [f'/{path.relative_to(ROOT)}' for folder in SOURCES for path in (
        ROOT / folder).rglob('*') if path.suffix in ENDINGS]
    for name in set(re.findall(r'`([\w./]+\.(?:py|msg|srv|xml|sh))`', page.read_text())):
        assert name in INVENTED or any(path.endswith(f'/{name}') for path in known), name


@pytest.mark.parametrize('page', [page for page in PAGES if page.name not in GENERATED], ids=str)
def test_python_of_a_page_compiles(page: Path) -> None:
    for code in blocks(page, 'python'):
        compile(code, str(page), 'exec')


def test_python_of_the_readme_runs() -> None:
    code, = blocks(ROOT / 'README.md', 'python')
    names: dict[str, Any] = {}
    exec(compile(code, 'README.md', 'exec'), names)
    assert names['observation'].shape == (256, 15)


def test_python_of_the_gymnasium_page_runs(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip('stable_baselines3')
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for code in blocks(ROOT / 'docs' / 'tutorials' / 'gymnasium.md', 'python'):
        exec(compile(code, 'gymnasium.md', 'exec'), names)
    assert names['picture'].shape == (400, 600, 3)
    assert names['model'].num_timesteps == 2048
    assert trajectories(tmp_path / 'flights.rrd')


def test_the_readme_is_short_and_says_how_to_test() -> None:
    """At most 150 lines; continuous integration reads the section about tests."""
    text = (ROOT / 'README.md').read_text()
    assert len(text.splitlines()) <= 150
    assert '\n## Tests\n\n```sh\n./launch_scripts/test\n```\n' in text


def test_the_page_of_commands_lists_all_commands() -> None:
    page = ROOT / 'docs' / 'reference' / 'commands.md'
    commands = {
        path.name for path in (ROOT / 'launch_scripts').iterdir()
        if path.is_file() and path.stat().st_mode & 0o100}
    assert commands == headings(page) - {'commands'}


def test_the_page_of_nodes_lists_all_nodes_and_messages() -> None:
    page = (ROOT / 'docs' / 'reference' / 'nodes-and-topics.md').read_text()
    for package in PACKAGES[1:]:
        nodes = re.findall(
            r"'(\w+) = \w+\.entry_points:", (ROOT / package / 'setup.py').read_text())
        assert nodes
        for node in nodes:
            assert f'`{node}`' in page, node
    interfaces = {
        path.stem for path in (ROOT / 'rocket_msgs').rglob('*')
        if path.suffix in ('.msg', '.srv', '.action')}
    named = re.findall('`rocket_msgs/[a-z]+/([A-Z][A-Za-z]+)`', page)
    assert interfaces - {'Setting', 'FlightFigures'} == set(named)


def test_every_preset_is_explained() -> None:
    page = (ROOT / 'docs' / 'how-to' / 'train.md').read_text()
    for preset in preset_names():
        assert f'| `{preset}` |' in page, preset


def test_all_packages_have_one_version() -> None:
    versions = {
        package: re.search(r'<version>(.*)</version>', (
            ROOT / package / 'package.xml').read_text())[1]
        for package in PACKAGES}
    versions |= {
        f'{package}/setup.py': re.search(
            r"version='(.*)'", (ROOT / package / 'setup.py').read_text())[1]
        for package in PACKAGES[1:]}
    versions |= {
        f'{package}.__version__': import_module(package).__version__ for package in PACKAGES[1:]}
    for name, pattern in (
            ('CITATION.cff', r'^version: (.*)$'), ('README.md', r'This is version ([\d.]+\d)\.'),
            ('CHANGELOG.md', r'all packages say\n([\d.]+\d)\.')):
        versions[name] = re.search(pattern, (ROOT / name).read_text(), re.MULTILINE)[1]
    assert len(set(versions.values())) == 1, versions


@pytest.mark.parametrize('kind', ['msg', 'srv', 'action'])
def test_every_field_of_a_message_has_a_comment(kind: str) -> None:
    """With unit, frame and shape, as far as it has them."""
    for path in (ROOT / 'rocket_msgs' / kind).iterdir():
        for line in path.read_text().splitlines():
            if line and not line.lstrip().startswith('#') and line != '---':
                constant = re.fullmatch(r'\w+ [A-Z_]+=\d+( .*)?', line)
                assert constant or ' # ' in line, f'{path.name}: {line}'


def test_every_source_file_names_its_licence() -> None:
    missing = [
        str(path.relative_to(ROOT))
        for folder in (*PACKAGES, 'launch_scripts', 'tests', 'docs')
        for path in (ROOT / folder).rglob('*')
        if path.suffix in ('.py', '.sh', '.msg', '.srv', '.action', '.xml', '.cfg', '.yaml')
        and 'SPDX-License-Identifier: Apache-2.0' not in path.read_text()[:200]]
    assert not missing
