# SPDX-License-Identifier: Apache-2.0
"""Page of one run or evaluation: headline, figures, pictures, settings, files."""
from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

from ppo_agent_node.evaluation import conditions_files
from ppo_agent_node.reporting.pages import figures_table
from ppo_agent_node.reporting.pages import html
from ppo_agent_node.reporting.pages import settings_table
from ppo_agent_node.reporting.pages.html import Markup
from ppo_agent_node.reporting.pictures.catalogue import CONDITIONS
from ppo_agent_node.reporting.pictures.catalogue import EVALUATION
from ppo_agent_node.reporting.pictures.catalogue import TRAINING
from ppo_agent_node.reporting.pictures.catalogue import Picture
from ppo_agent_node.reporting.run_files import EPISODES
from ppo_agent_node.reporting.run_files import FIGURES
from ppo_agent_node.reporting.run_files import Run
from ppo_agent_node.statistics import BOOTSTRAPPED
from rocket_sim_node.palette import words

REPORT = 'report.html'
_FILES = {
    'config.yaml': 'every setting and the seed',
    'train.jsonl': 'the log: one line per iteration, each a JSON object',
    'evaluation.json': 'figures of the evaluation',
    'episodes.csv': 'the episodes of the evaluation, one per line; column names contain the units',
    'conditions.json': 'the table of conditions: the figures of every cell',
    'conditions.md': 'the same as a readable table',
    'conditions.csv': 'the same, one cell per line',
    'policy.safetensors': 'the best policy, with a description of world and training',
    'cloned.safetensors': 'the clone, before fine-tuning',
    'recording.rrd': 'the flights, for Rerun: rerun recording.rrd',
    'recording.partial.rrd': 'the recording while it is written, recording.rrd afterwards',
    'checkpoints': 'complete states of the training: the newest two and the best',
    'plots': 'the pictures of this page',
    REPORT: 'this page',
}
_FACTS = (
    ('policy', 'pilot'), ('policy_file', 'file of the policy'),
    ('policy_sha256', 'its SHA-256'), ('seed', 'seed of the evaluation'),
    ('training_seed', 'seed of the training'), ('num_envs', 'rockets flown at once'),
)


def run_page(run: Run, pictures: Sequence[Picture]) -> str:
    """Return the page of a run.

    :param pictures: already drawn; they are embedded in the page.
    """
    title = f'{run.name}: {run.world or "run"}'
    return html.document(
        title, _headline(run), *_notes(run), *_evaluation(run, pictures),
        *_conditions(run, pictures), *_section(TRAINING, pictures), *_settings(run),
        _files(run.path))


def _headline(run: Run) -> Markup:
    """Return the title and the cards."""
    figures = run.figures or {}
    items = [('world', run.world or '?', _level(run))]
    if figures:
        items += [
            ('landed', figures_table.rate(figures['landing_rate']),
             f'95 %: {figures_table.interval_of_rate(figures, "landing_rate")}'),
            ('mean return', f'{figures["mean_return"]:.2f}', '95 %: {:.2f} to {:.2f}'.format(
                *figures['mean_return_interval'])),
            ('episodes', f'{figures["episodes"]}', f'seed {figures.get("seed", "?")}')]
    if run.training:
        items.append(('training seed', str(run.training.get('seed', '?')), ''))
    if run.seconds is not None:
        steps = run.lines[-1].get('steps') if run.lines else None
        more = f'{steps:,} steps'.replace(',', ' ') if isinstance(steps, int) else ''
        items.append(('time', figures_table.duration(run.seconds), more))
    items.append(('date', f'{run.date:%Y-%m-%d}', f'{run.date:%H:%M %Z}'))
    kind = 'Training run' if run.lines or run.config else 'Evaluation'
    return Markup(
        html.tag('h1', run.name)
        + html.tag('p', f'{kind} of Hoverslam: landing rockets by reinforcement learning',
                   class_='lead')
        + html.cards(items))


def _level(run: Run) -> str:
    """Return level and conditions as text, '' if there are none."""
    figures = run.figures or {}
    level = figures.get('level')
    if level is None:
        level = run.training.get('curriculum_final_level')
    where = [f'level {level}'] if level else []
    if figures.get('conditions') not in (None, 'nominal'):
        where.append(f'conditions {figures["conditions"]}')
    return ', '.join(where)


def _notes(run: Run) -> list[Markup]:
    """Return notes on what is missing."""
    notes = []
    if run.figures is None and (run.config or run.lines):
        notes.append(f'No {FIGURES}: this run has not been evaluated yet.')
    elif run.figures is not None and run.episodes is None:
        notes.append(
            f'No {EPISODES}: this evaluation kept only its figures, so plots of single episodes '
            'cannot be drawn. Evaluate again to get them.')
    if run.config and not run.stage('finetune'):
        notes.append('No iterations of fine-tuning in the log yet.')
    return [html.tag('div', note, class_='note') for note in notes]


def _evaluation(run: Run, pictures: Sequence[Picture]) -> list[Markup]:
    """Return table and pictures of the evaluation."""
    if run.figures is None:
        return []
    facts = [(label, str(run.figures[name])) for name, label in _FACTS
             if run.figures.get(name) is not None]
    ends = ', '.join(
        f'{words(name)} {count}' for name, count in run.figures['outcomes'].items() if count)
    return [
        html.tag('h2', EVALUATION),
        html.table(figures_table.HEAD, figures_table.rows(run.figures, run.episodes)),
        html.tag(
            'p', f'Outcomes: {ends}. Intervals: Wilson for rates; for means bootstrap up to '
            f'{BOOTSTRAPPED:,} values, normal beyond.', class_='soft'),
        html.tag('details', html.tag('summary', 'Pilot and starts'),
                 html.table((), facts)),
        *_section(EVALUATION, pictures)[1:]]


def _conditions(run: Run, pictures: Sequence[Picture]) -> list[Markup]:
    """Return picture and numbers of the table of conditions."""
    if run.conditions is None:
        return []
    parts = _section(CONDITIONS, pictures)
    parts.append(html.tag('p', conditions_files.facts(run.conditions), class_='soft'))
    for level in run.conditions['levels']:
        head, *rows = conditions_files.rows(run.conditions, level)
        parts.append(html.tag(
            'details', html.tag('summary', f'Level {level}, in numbers'),
            html.table(head, rows, 'numbers')))
    return parts


def _section(title: str, pictures: Sequence[Picture]) -> list[Markup]:
    """Return the heading and the pictures of a section; nothing without pictures."""
    chosen = [picture for picture in pictures if picture.section == title]
    return [html.tag('h2', title)] * bool(chosen) + [
        html.figure(picture.path, picture.title, picture.caption) for picture in chosen]


def _settings(run: Run) -> list[Markup]:
    """Return all settings, by section, with a search field."""
    found = settings_table.sections(run)
    if not found:
        return []
    parts = [html.tag('h2', 'Settings'), Markup(
        '<p class="soft">Marked settings differ from the preset, or from the default.</p>'
        '<input class="screen" type="search" aria-label="Search the settings" '
        'placeholder="Search the settings">')]
    for section in found:
        differing = sum(setting.differs for setting in section.settings)
        summary = f'{section.title}: {len(section.settings)} settings' + (
            f', {differing} changed' if differing else '')
        parts.append(html.tag('details', html.tag('summary', summary), html.table(
            ('name', 'value', 'default', 'meaning'),
            [(html.tag('code', one.name), html.tag('code', one.value),
              html.tag('code', one.usual) if one.usual else '', one.meaning)
             for one in section.settings],
            'settings', [one.differs for one in section.settings]),
            class_='settings'))
    return parts


def _files(folder: Path) -> Markup:
    """Return the list of files, each with a link and a description."""
    names = {path.name: path for path in sorted(folder.iterdir()) if path.name[0] != '.'}
    names.setdefault(REPORT, folder / REPORT)
    rows = []
    for name in sorted(names, key=lambda name: (name not in _FILES, name)):
        path = names[name]
        inner = sorted(one.name for one in path.iterdir()) if path.is_dir() else []
        size = f'{len(inner)} files' if path.is_dir() else (
            _size(path.stat().st_size) if path.exists() and name != REPORT else '')
        meaning = _FILES.get(name, '') + (f': {", ".join(inner)}' if inner else '')
        link = html.tag('a', name + '/' * path.is_dir(), href=f'./{quote(name)}')
        rows.append((link, size, meaning))
    return Markup(html.tag('h2', 'Files') + html.table(('file', 'size', 'content'), rows))


def _size(count: int) -> str:
    """Return a number of bytes as text."""
    return f'{count / 1e6:.1f} MB' if count >= 1e6 else f'{max(1, round(count / 1e3))} kB'
