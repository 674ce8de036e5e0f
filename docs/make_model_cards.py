# SPDX-License-Identifier: Apache-2.0
"""Writes the model cards of the shipped policies: `python docs/make_model_cards.py --fly`.

With `--fly` it first flies the policies, in this process, and writes the figures to
`policies/results.json`, which takes a minute or two. Without `--fly` it writes the cards from that
file. Run it with the environment active (`. launch_scripts/env.sh`), with `--fly` after a policy
has been replaced. A test fails if a card is stale.
"""
from __future__ import annotations

import argparse
import hashlib
import json
from datetime import UTC
from datetime import datetime
from pathlib import Path
from typing import Any

from ppo_agent_node.atomic_file import write_atomically
from ppo_agent_node.evaluation import metrics
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.exporting import provenance
from ppo_agent_node.exporting import units
from ppo_agent_node.exporting.policy_export import world_of
from ppo_agent_node.pilots.policy import PolicyPilot
from ppo_agent_node.pilots.search import shipped_names
from ppo_agent_node.ppo.policies.file import POLICY
from ppo_agent_node.runs import tensor_file
from ppo_agent_node.runs.source_commit import source_commit
from rocket_sim_node import worlds
from rocket_sim_node.gym import IDS

RESULTS = provenance.SHIPPED / 'results.json'
EPISODES = 2000
SEED = 40_000_000
"""First seed of the starts; no training and no selection uses them."""
_ENVS = 250
_LEVELS = {'level 7': {'level': 7}, 'level 8': {'level': 8}}
TASKS: dict[str, dict[str, dict[str, Any]]] = {
    'rocket': _LEVELS, 'rocket_planar': _LEVELS, 'lunar_lander': {'default settings': {}},
    'robust': {
        'level 7': {'level': 7}, 'level 7, conditions mix': {'level': 7, 'conditions': 'mix'},
        'level 8, conditions mix': {'level': 8, 'conditions': 'mix'},
        'level 7, conditions harsh': {'level': 7, 'conditions': 'harsh'}},
    'hoverslam': {'level 7, conditions hoverslam': {'level': 7, 'conditions': 'hoverslam'}},
    'from_scratch': {'level 7': {'level': 7}}}
"""Tasks that each policy flies, and their reset settings."""
_WHAT = {
    'rocket': 'Lands a rocket with one engine and attitude thrusters from 200 m. A scripted pilot '
              'was cloned, then PPO improved the clone.',
    'rocket_planar': 'Lands the same rocket in a vertical plane, up to rest on its legs. A '
                     'scripted pilot was cloned, then PPO improved the clone.',
    'lunar_lander': "Lands Gymnasium's LunarLander-v3, reimplemented. It was trained by PPO "
                    'alone.',
    'robust': 'Lands rockets without knowing their mass, thrust, lag, delay and side force. It '
              'observes its last commands and accelerations. A pilot that identifies the vehicle '
              'in flight was cloned, then PPO improved the clone.',
    'hoverslam': 'Lands a rocket whose engine cannot hover and can be lit only once. A scripted '
                 'pilot was cloned, then PPO improved the clone.',
    'from_scratch': 'Lands a rocket from 200 m. It was trained by PPO alone with a reverse '
                    'curriculum, without demonstrations or shaping.'}
_KEPT = ('episodes', 'landed', 'landing_rate', 'landing_rate_interval', 'mean_return',
         'mean_return_interval', 'return_std')
_SPREADS = ('touchdown_speed', 'tilt', 'distance')


def path_of(name: str) -> Path:
    """Return the file of a shipped policy."""
    return provenance.SHIPPED / f'{name}.safetensors'


def sha256(name: str) -> str:
    """Return the digest of a policy's file."""
    return hashlib.sha256(path_of(name).read_bytes()).hexdigest()


def fly(name: str, episodes: int = EPISODES) -> dict[str, Any]:
    """Return the figures of a policy by task, with digest, seed, commit and date."""
    spec = world_of(path_of(name), content(name))
    seen = {'observation': worlds.settings_from(spec.name, spec.settings)['observation']} if (
        'observation' in spec.settings) else {}
    world = worlds.make(spec.name, min(_ENVS, episodes), 0, **seen)
    pilot = PolicyPilot(path_of(name), world.spec)
    tasks = {}
    for task, settings in TASKS[name].items():
        summary = metrics.summarise(evaluate(world, pilot, episodes, SEED, **settings))
        tasks[task] = {key: summary[key] for key in _KEPT} | {
            key: summary[key]['p95'] for key in _SPREADS}
    return {
        'policy_sha256': sha256(name), 'seed': SEED, 'commit': source_commit(),
        'date': f'{datetime.now(UTC):%Y-%m-%d}', 'tasks': tasks}


def content(name: str) -> dict[str, Any]:
    """Return the description in a policy's file."""
    return tensor_file.read(path_of(name), POLICY).content


def results() -> dict[str, Any]:
    """Return the figures of all policies."""
    found: dict[str, Any] = json.loads(RESULTS.read_text('utf-8'))
    return found


def card(name: str) -> str:
    """Return the model card of a policy, Markdown with the header of the Hugging Face Hub."""
    contents, figures = content(name), results()[name]
    spec = world_of(path_of(name), contents)
    where = provenance.shipped()[name]
    drawn = where['conditions'] if where['conditions'] != 'nominal' else ''
    return '\n'.join([
        *_header(name, spec.name, figures), '',
        f'# {name}', '',
        '<!-- Written by docs/make_model_cards.py. Do not edit it. -->', '',
        _WHAT[name], '',
        '## Fly it', '', '```sh',
        f'./launch_scripts/land world:={spec.name} policy:={name}'
        + (f' conditions:={drawn}' if drawn else ''),
        f'./launch_scripts/export policy:={name} output:={name}.onnx', '```', '',
        'In Python, without ROS:', '', '```python',
        'from ppo_agent_node.pilots.policy import PolicyPilot',
        'from ppo_agent_node.pilots.search import find_policy',
        'from rocket_sim_node import worlds', '',
        f'world = worlds.make({spec.name!r}, num_envs=16{_seen(spec, drawn)})',
        f'pilot = PolicyPilot(find_policy({name!r}, {spec.name!r}), world.spec)',
        'observation = world.reset(seed=1)',
        'observation, reward, terminated, truncated, info = world.step(pilot(observation))',
        '```', '',
        *_results(figures), '', *_training(contents, where), '', *_interface(spec), '',
        '## Limits', '', _limits(name), '',
        f'File: `{name}.safetensors`, SHA-256 `{figures["policy_sha256"]}`.', ''])


def _seen(spec: worlds.WorldSpec, drawn: str) -> str:
    given = f', conditions={drawn!r}' if drawn else ''
    return given + (", observation='extended'" if spec.settings.get('observation') else '')


def _header(name: str, world: str, figures: dict[str, Any]) -> list[str]:
    lines = [
        '---', 'license: apache-2.0', 'library_name: hoverslam',
        'pipeline_tag: reinforcement-learning', 'tags:', '- reinforcement-learning', '- robotics',
        '- ros2', f'- {IDS[world]}', 'model-index:', f'- name: {name}', '  results:']
    for task, found in figures['tasks'].items():
        lines += [
            '  - task:', '      type: reinforcement-learning',
            '      name: reinforcement-learning', '    dataset:',
            f'      name: "{IDS[world]}, {task}"', f'      type: {IDS[world]}', '    metrics:',
            '    - type: mean_reward',
            f'      value: {found["mean_return"]:.2f} +/- {found["return_std"]:.2f}',
            '      name: mean_reward', '      verified: false',
            '    - type: landing_rate', f'      value: {found["landing_rate"]:.4f}',
            '      name: landing_rate', '      verified: false']
    return [*lines, '---']


def _results(figures: dict[str, Any]) -> list[str]:
    lines = [
        '## Results', '',
        f'{figures["date"]}, {figures["commit"]}: deterministic flights in one process. The '
        f'starts have seed {figures["seed"]}, which no training used. '
        '95 % intervals are in brackets.', '',
        '| task | episodes | landed | mean return | touchdown, 95 % below | tilt | distance |',
        '| --- | --- | --- | --- | --- | --- | --- |']
    for task, found in figures['tasks'].items():
        low, high = (100 * bound for bound in found['landing_rate_interval'])
        least, most = found['mean_return_interval']
        lines.append(
            f'| {task} | {found["episodes"]} | {100 * found["landing_rate"]:.2f} % '
            f'[{low:.2f}, {high:.2f}] | {found["mean_return"]:.2f} [{least:.2f}, {most:.2f}] '
            f'| {found["touchdown_speed"]:.3f} m/s | {found["tilt"]:.2f}° '
            f'| {found["distance"]:.2f} m |')
    return lines


def _training(contents: dict[str, Any], where: dict[str, Any]) -> list[str]:
    training = contents['training']
    return [
        '## Training', '',
        f'`./launch_scripts/train world:={contents["world"]} preset:={where["preset"]} '
        f'seed:={contents["seed"]}`, commit {where["commit"]}, conditions '
        f'`{where["conditions"]}`, run `{training["run"]}`: {training["steps"]:,} steps of one '
        f'vehicle. The policy is from iteration {training["iteration"]} of PPO, which was the '
        f'best on the {training["episodes"]} selection starts.', '',
        f'Network: {len(contents["observation_names"])} observations, features '
        f'`{contents["features"]}`, hidden layers {contents["hidden_sizes"]}, '
        f'{contents["activation"]}.']


def _interface(spec: worlds.WorldSpec) -> list[str]:
    lines = [
        '## Observations and actions', '',
        f'One action is taken every {spec.dt:g} s. Multiply an observation by its scale to get '
        'the quantity in its unit.', '',
        '| column | observation | scale | unit |', '| --- | --- | --- | --- |']
    seen = zip(spec.observation_names, units.observation_units(spec), strict=True)
    lines += [
        f'| {column} | `{name}` | {unit.scale:g} | {unit.unit} |'
        for column, (name, unit) in enumerate(seen)]
    if not spec.continuous:
        return [*lines, '', f'Action: one of {spec.action_count}, `{spec.action_names[0]}`.']
    lines += ['', '| column | action | from | to |', '| --- | --- | --- | --- |']
    return lines + [
        f'| {column} | `{name}` | {low:g} | {high:g} |' for column, (name, low, high) in enumerate(
            zip(spec.action_names, spec.action_low, spec.action_high, strict=True))]


def _limits(name: str) -> str:
    tested = 'the tasks above' if len(TASKS[name]) > 1 else 'the task above'
    return (
        f'The policy was trained and tested only in simulation, on {tested}, and never on a real '
        'vehicle. It may crash with masses, thrusts, delays or sensors other than those of its '
        'training; `./launch_scripts/evaluate conditions:=all` tests rocket policies under many '
        'conditions.')


def main() -> None:
    """Write all cards."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('--fly', action='store_true', help='fly the policies first')
    if parser.parse_args().fly:
        found = {name: fly(name) for name in shipped_names()}
        write_atomically(RESULTS, (json.dumps(found, indent=1) + '\n').encode())
    for name in shipped_names():
        write_atomically(path_of(name).with_suffix('.md'), card(name).encode())


if __name__ == '__main__':
    main()
