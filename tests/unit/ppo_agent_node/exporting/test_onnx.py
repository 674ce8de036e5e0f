# SPDX-License-Identifier: Apache-2.0
"""Policies as ONNX files: equal actions, described, flown without PyTorch, or refused."""
from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ppo_agent_node.commands import export as command
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.exporting.policy_export import OBSERVATIONS
from ppo_agent_node.exporting.policy_export import TOLERANCE
from ppo_agent_node.exporting.policy_export import export
from ppo_agent_node.exporting.policy_export import sample
from ppo_agent_node.pilots.policy import PolicyPilot
from ppo_agent_node.pilots.search import find_policy
from ppo_agent_node.pilots.search import shipped_names
from rocket_sim_node import worlds

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]
onnx = pytest.importorskip('onnx')
pytest.importorskip('onnxruntime')
pytest.importorskip('onnxscript')
WORLDS = {'rocket_planar': 'rocket_planar', 'lunar_lander': 'lunar_lander'}
RICH = ('robust', 'hoverslam')
KINDS = ('rocket', 'lunar_lander', 'robust')
"""With 15 observations, with choices instead of actions, and with 33 observations."""


def shipped(name: str) -> Path:
    """Return the file of a policy that ships."""
    return find_policy(name, 'rocket')


@pytest.fixture(scope='module')
def files(
    tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest,
) -> dict[str, Path]:
    """Policies that ship, exported, by name: one of each kind; with `--nightly`, all."""
    folder = tmp_path_factory.mktemp('onnx')
    found = {}
    for name in shipped_names() if request.config.getoption('--nightly') else KINDS:
        done = export(shipped(name), folder / f'{name}.onnx')
        assert done.observations == OBSERVATIONS
        assert done.difference <= max(TOLERANCE, 2 * done.rounding)
        assert done.rounding < 1e-4
        found[name] = done.path
    return found


@pytest.mark.parametrize('name', shipped_names())
def test_actions_are_those_of_pytorch_in_any_batch(files: dict[str, Path], name: str) -> None:
    if name not in files:
        pytest.skip('another one of its kind: --nightly')
    seen = {'observation': 'extended'} if name in RICH else {}
    spec = worlds.make(WORLDS.get(name, 'rocket'), 1, **seen).spec
    observation = sample(shipped(name), spec, 1000)
    assert observation.shape == (1000, spec.observation_size)
    wanted, pilot = PolicyPilot(shipped(name), spec)(observation), PolicyPilot(files[name], spec)
    for size in (1, 7, 1000):
        found = pilot(observation[:size])
        assert found.dtype == wanted.dtype
        if spec.continuous:
            # More than the export allows, as PyTorch differs from itself from batch to batch.
            assert np.abs(found - np.clip(wanted[:size], -1, 1)).max() < 5 * TOLERANCE
        else:
            assert (found == wanted[:size]).mean() > 0.99


def test_a_file_describes_its_policy(files: dict[str, Path]) -> None:
    world = worlds.make('rocket', 1, observation='extended')
    description = PolicyPilot(files['robust'], world.spec).description
    names, units = description['observation_names'], description['observation_units']
    assert dict(zip(names, units, strict=True))['acceleration_1_y'] == 'm/s^2'
    assert description['observation_scales'][names.index('position_y')] == 50.0
    assert description['observation_high'][names.index('command_1_throttle')] == 1.0
    assert description['action_names'] == ['throttle', 'rcs_x', 'rcs_z']
    assert description['action_units'] == ['1'] * 3
    assert description['action_choices'] == []
    assert (description['action_low'], description['action_high']) == ([-1.0] * 3, [1.0] * 3)
    assert (description['world'], description['seed'], description['training']['run']) == (
        'rocket', 65, 'rocket-robust-65')
    assert description['provenance']['conditions'] == 'mix'
    assert description['provenance']['commit']
    lander = worlds.make('lunar_lander', 1)
    description = PolicyPilot(files['lunar_lander'], lander.spec).description
    assert description['observation_low'][0] is None
    assert description['observation_units'][4:6] == ['rad', 'rad/s']
    # A body that turns at 1 rad/s is seen to turn at 0.4: the scale is the way back.
    assert description['observation_scales'][5] == 2.5
    assert description['action_choices'] == ['none', 'left', 'main', 'right']


def test_the_same_export_is_the_same_file_and_names_no_paths(
        files: dict[str, Path], tmp_path: Path) -> None:
    again = export(shipped('lunar_lander'), tmp_path / 'again.onnx').path.read_bytes()
    assert again == files['lunar_lander'].read_bytes()
    assert b'site-packages' not in again
    assert str(Path(__file__).parents[4]).encode() not in again
    onnx.checker.check_model(onnx.load_model_from_string(again), full_check=True)


@pytest.mark.parametrize('name', ['rocket', 'lunar_lander'])
def test_an_exported_policy_lands_as_the_original_does(files: dict[str, Path], name: str) -> None:
    world = worlds.make(name, 32)
    results = [
        evaluate(world, PolicyPilot(path, world.spec), 32, 7) for path in
        (shipped(name), files[name])]
    assert all(result.landed.all() for result in results)
    mean = [result.episodes.episode_return.mean() for result in results]
    # Equal but for rounding, which a choice of the lander may amplify.
    assert mean[0] == pytest.approx(mean[1], abs=0.01 if name == 'rocket' else 5.0)


@pytest.mark.parametrize('bad', [np.nan, np.inf, -np.inf])
def test_a_discrete_policy_does_not_fly_on_nan(files: dict[str, Path], bad: float) -> None:
    spec = worlds.make('lunar_lander', 2).spec
    pilot = PolicyPilot(files['lunar_lander'], spec)
    observation = np.zeros((2, spec.observation_size), np.float32)
    assert pilot(observation).shape == (2,)
    observation[1, 0] = bad
    with pytest.raises(ValueError, match='the probabilities of row 1 are not finite'):
        pilot(observation)


def test_an_exported_policy_flies_without_pytorch(files: dict[str, Path]) -> None:
    code = f"""
import sys
sys.modules['torch'] = sys.modules['safetensors'] = None
import ppo_agent_node.commands.launch
import ppo_agent_node.nodes.agent.inference
import ppo_agent_node.nodes.agent.modes
import ppo_agent_node.nodes.evaluate
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.pilots.choice import choose
from rocket_sim_node import worlds
world = worlds.make('rocket', 8)
chosen = choose('policy', world.spec, policy={str(files['rocket'])!r})
assert evaluate(world, chosen.pilot, 8, 1).landed.all()
try:
    choose('policy', world.spec, policy='default')
except ValueError as error:
    print(error)
"""
    done = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    assert 'rocket.safetensors: needs PyTorch' in done.stdout


def damaged(path: Path, how: str) -> bytes:
    """Return the content of a file that holds no good policy any more."""
    data = path.read_bytes()
    if how == 'cut short':
        return data[:len(data) // 2]
    if how == 'one bit':
        middle = len(data) // 3
        return data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1:]
    if how == 'foreign':
        model = onnx.load_model_from_string(data)
        model.ClearField('metadata_props')
        return bytes(model.SerializeToString())
    if how == 'safetensors':
        return shipped('rocket').read_bytes()
    return b''


@pytest.mark.parametrize(('how', 'reason'), [
    ('cut short', 'holds no complete policy'), ('one bit', 'damaged, its content has'),
    ('foreign', 'holds no complete policy'), ('safetensors', 'holds no complete policy'),
    ('empty', 'holds no')])
def test_a_bad_file_is_refused_in_one_line(
        files: dict[str, Path], tmp_path: Path, how: str, reason: str) -> None:
    path = tmp_path / 'bad.onnx'
    path.write_bytes(damaged(files['rocket'], how))
    with pytest.raises(ValueError, match=reason) as caught:
        PolicyPilot(path, worlds.make('rocket', 1).spec)
    assert str(caught.value).startswith(f'{path}: ')
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize(('name', 'world', 'reason'), [
    ('lunar_lander', 'rocket', 'observation_names of the policy: got .* .world .lunar_lander..'),
    ('rocket', 'lunar_lander', 'observation_names of the policy: got .* .world .rocket..'),
    ('robust', 'rocket', 'the policy also sees command_1_throttle')])
def test_a_file_for_another_world_is_refused(
        files: dict[str, Path], name: str, world: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        PolicyPilot(files[name], worlds.make(world, 1).spec)


def test_an_exported_policy_gets_only_its_own_columns(files: dict[str, Path]) -> None:
    plain, rich = worlds.make('rocket', 4), worlds.make('rocket', 4, observation='extended')
    seen = rich.reset(seed=1)
    assert np.array_equal(
        PolicyPilot(files['rocket'], rich.spec)(seen),
        PolicyPilot(files['rocket'], plain.spec)(np.ascontiguousarray(seen[:, :15])))


@pytest.mark.parametrize(('arguments', 'reason'), [
    (['polcy:=rocket', 'output:=x.onnx'], "unknown argument 'polcy', did you mean 'policy'?"),
    (['policy:=rocket'], "output: got '', expected a name that ends with .onnx"),
    (['policy:=rocket', 'output:=missing/x.onnx'], 'expected a file in a folder that exists'),
    (['policy:=rockt', 'output:=x.onnx'], "policy: got 'rockt', expected a file or the name")])
def test_the_command_refuses_bad_arguments_in_one_line(
        arguments: list[str], reason: str, capsys: pytest.CaptureFixture[str],
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, 'argv', ['export', *arguments])
    with pytest.raises(SystemExit, match='2'):
        command.main()
    error = capsys.readouterr().err
    assert reason in error
    assert error.count('\n') == 1


def test_the_command_writes_a_file_once(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    output = tmp_path / 'lander.onnx'
    monkeypatch.setattr(sys, 'argv', ['export', 'policy:=lunar_lander', f'output:={output}'])
    command.main()
    assert f'./launch_scripts/land policy:={output}' in capsys.readouterr().out
    with pytest.raises(SystemExit, match='2'):
        command.main()
    assert 'already exists' in capsys.readouterr().err
