# SPDX-License-Identifier: Apache-2.0
"""One PPO update by our learner, by autograd and by Stable-Baselines3; and its matrix products.

Each side runs in a process of its own, so its threads and environment variables are the same as
without the other sides.
"""
from __future__ import annotations

import importlib
import multiprocessing
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any
from typing import Protocol


@dataclass(frozen=True)
class Case:
    """The default preset of a world, with a given number of rockets and minibatch size."""

    world: str
    rockets: int
    batch_size: int

    @property
    def name(self) -> str:
        return f'{self.world}, minibatch {self.batch_size}'


CASES = (
    Case('rocket', 256, 4096), Case('lunar_lander', 64, 512), Case('lunar_lander', 64, 64))


@dataclass(frozen=True)
class Options:
    """Options of one side."""

    case: Case
    threads: int
    device: str
    samples: int
    """samples in the batch; 0: as many as in a roll-out of the preset"""


class Side(Protocol):
    """One side of the comparison, to be timed."""

    samples: int
    """samples in the batch, times epochs"""

    def reset(self) -> None: ...

    def update(self) -> dict[str, float]: ...


class Ours:
    """Our learner and the fixed batch; the other sides copy its weights and samples."""

    def __init__(self, options: Options, **changes: Any) -> None:
        import torch

        from ppo_agent_node.config.presets import load_preset
        from ppo_agent_node.ppo.learner import Learner
        from ppo_agent_node.ppo.rollout_buffer import Batch
        from rocket_sim_node import worlds

        torch.set_num_threads(options.threads)
        case = options.case
        self.spec = worlds.make(case.world, num_envs=case.rockets).spec
        self.config = load_preset('default', case.world, **{
            'batch_size': case.batch_size, 'target_kl': 0.0, 'critic_warmup_iterations': 0,
            # The other sides train a critic, too, and all layers, and have neither features nor a
            # symmetry.
            'start_copies': 1, 'trained_layers': 0, 'features': 'none', 'symmetry': 'none',
            'exploration': 'independent',
            'threads': options.threads, 'device': options.device, **changes})
        self.learner = Learner(self.spec, self.config)
        count = options.samples or self.config.ppo.n_steps * case.rockets
        noise = torch.Generator().manual_seed(1)
        observation = torch.randn(count, self.spec.observation_size, generator=noise)
        with torch.no_grad():
            action, log_prob = self.learner.policy.sample(observation, noise)
            value = self.learner.critic(observation)
        # As if the policy had been updated since: some ratios are outside the clip range.
        log_prob += 0.1 * torch.randn(count, generator=noise)
        advantage, error = torch.randn(2, count, generator=noise)
        self.batch = Batch(observation, action, log_prob, advantage, value + error, value)
        self.samples = count * self.config.ppo.n_epochs
        self._start = self.learner.tensors()

    def reset(self) -> None:
        self.learner.load(Path('start'), self._start)

    def update(self) -> dict[str, float]:
        diagnostics = self.learner.improve(1, self.batch, lambda: None)[0]
        return {'policy_loss': diagnostics.policy_loss, 'value_loss': diagnostics.value_loss}


class Autograd(Ours):
    """The same update by autograd and torch's fused Adam, without hand-written gradients."""

    def reset(self) -> None:
        """Restore the weights and make new optimisers."""
        from support.training import ppo_reference

        super().reset()
        ppo = self.config.ppo
        self._adams = ppo_reference.optimisers(
            self.learner.policy, self.learner.critic,
            (ppo.actor_learning_rate, ppo.log_std_learning_rate, ppo.critic_learning_rate),
            fused=True)

    def update(self) -> dict[str, float]:
        """Learn from the batch with the textbook algorithm."""
        import torch
        from support.training import ppo_reference

        diagnostics = ppo_reference.update(
            self.learner.policy, self.learner.critic, self._adams, self.batch, self.config.ppo,
            torch.Generator().manual_seed(1))
        return {'policy_loss': diagnostics.policy_loss, 'value_loss': diagnostics.value_loss}


class StableBaselines3:
    """Stable-Baselines3's PPO with the same networks, batch and settings."""

    def __init__(self, options: Options, **changes: Any) -> None:
        import copy

        import gymnasium
        import torch
        from stable_baselines3 import PPO
        from stable_baselines3.common.logger import Logger

        ours = Ours(options, **changes)
        spec, ppo, network = ours.spec, ours.config.ppo, ours.config.network
        count = len(ours.batch.value)
        self.samples = ours.samples

        class Spaces(gymnasium.Env):  # type: ignore[type-arg]
            observation_space = gymnasium.spaces.Box(-1e9, 1e9, (spec.observation_size,))
            action_space = gymnasium.spaces.Box(-1, 1, (spec.action_size,)) if (
                spec.continuous) else gymnasium.spaces.Discrete(spec.action_count)

        sizes = list(network.hidden_sizes)
        self.model = model = PPO(
            'MlpPolicy', Spaces(), n_steps=count, batch_size=ppo.batch_size,
            n_epochs=ppo.n_epochs, learning_rate=ppo.actor_learning_rate,
            clip_range=ppo.clip_range, ent_coef=ppo.entropy_coefficient, vf_coef=0.5,
            max_grad_norm=ppo.max_grad_norm, device=options.device, seed=1, policy_kwargs={
                'net_arch': {'pi': sizes, 'vf': sizes}, 'activation_fn': torch.nn.Tanh})
        model.set_logger(Logger(None, []))
        layers = [
            (*(part for part in net if isinstance(part, torch.nn.Linear)), last)
            for net, last in (
                (model.policy.mlp_extractor.policy_net, model.policy.action_net),
                (model.policy.mlp_extractor.value_net, model.policy.value_net))]
        with torch.no_grad():
            for theirs, our_network in zip(
                    layers, (ours.learner.policy, ours.learner.critic), strict=True):
                linear = [m for m in our_network.modules() if isinstance(m, torch.nn.Linear)]
                for target, source in zip(theirs, linear, strict=True):
                    target.load_state_dict(source.state_dict())
            if spec.continuous:
                model.policy.log_std.copy_(ours.learner.policy.log_std)
            batch = ours.batch
            filled = {
                'observations': ours.learner.policy.normaliser(batch.observation),
                'actions': batch.action, 'values': batch.value, 'log_probs': batch.log_prob,
                'advantages': batch.advantage, 'returns': batch.target}
        for name, tensor in filled.items():
            array = getattr(model.rollout_buffer, name)
            array[:] = tensor.cpu().numpy().reshape(array.shape)
        model.rollout_buffer.full = True
        self.layers = layers
        self._start = copy.deepcopy((
            model.policy.state_dict(), model.policy.optimizer.state_dict()))

    def reset(self) -> None:
        import copy

        weights, optimiser = copy.deepcopy(self._start)
        self.model.policy.load_state_dict(weights)
        self.model.policy.optimizer.load_state_dict(optimiser)

    def update(self) -> dict[str, float]:
        self.model.train()
        logged = self.model.logger.name_to_value
        return {'policy_loss': float(logged['train/policy_gradient_loss']),
                'value_loss': 0.5 * float(logged['train/value_loss'])}


class Floor:
    """Only the matrix products: forward, and backward for weights and inputs.

    Those of policy and critic run in parallel if there are enough threads.
    """

    def __init__(self, options: Options, rows: int = 0, one_dnn: bool = False) -> None:
        """Allocate the matrices; `rows` limits the number of samples in each product."""
        import torch

        from ppo_agent_node.ppo.networks.dense import product

        def by_mkl(left: Any, right: Any, out: Any) -> None:
            torch.mm(left, right, out=out)

        def by_one_dnn(left: Any, right: Any, out: Any) -> None:
            product(left, right)

        self._multiply = by_one_dnn if one_dnn else by_mkl

        ours = Ours(options)
        where = torch.device('cuda' if torch.cuda.is_available() and options.device != 'cpu'
                             else 'cpu')
        self.samples = ours.samples
        rows = min(rows or options.case.batch_size, options.case.batch_size)
        self._times = -(-self.samples // rows)
        self._products: list[list[tuple[Any, ...]]] = []
        self.flops = 0
        for network in (ours.learner.policy, ours.learner.critic):
            self._products.append([])
            linear = [m for m in network.modules() if isinstance(m, torch.nn.Linear)]
            for index, layer in enumerate(linear):
                outputs, inputs = layer.weight.shape
                x, dz = (torch.randn(rows, n, device=where) for n in (inputs, outputs))
                weight = torch.randn(outputs, inputs, device=where)
                products = [(x, weight.T, torch.empty_like(dz)),
                            (dz.T, x, torch.empty_like(weight))]
                products += [(dz, weight, torch.empty_like(x))] if index else []
                self._products[-1] += products
                self.flops += len(products) * 2 * inputs * outputs * self.samples

    def reset(self) -> None:
        pass

    def update(self) -> dict[str, float]:
        import torch

        from ppo_agent_node.ppo.parallel import both

        def run(products: list[tuple[Any, ...]]) -> None:
            for _ in range(self._times):
                for left, right, out in products:
                    self._multiply(left, right, out)

        policy, critic = self._products
        both(lambda poll: run(policy), lambda poll: run(critic), lambda: None)
        if policy[0][2].is_cuda:
            torch.cuda.synchronize()
        return {'flops': float(self.flops)}


SIDES: dict[str, Callable[[Options], Side]] = {
    'ours': Ours, 'autograd': Autograd, 'SB3': StableBaselines3,
    'SB3, threads sleep': StableBaselines3, 'floor': Floor,
    'floor, 512 rows': lambda options: Floor(options, 512),
    'floor, oneDNN': lambda options: Floor(options, 1024, one_dnn=True)}


def _serve(pipe: Connection, name: str, options: Options) -> None:
    if name == 'SB3':
        # Importing our package makes torch's idle threads sleep, which helps when other processes
        # need the cores. The other side is measured with its default and with this setting.
        os.environ.pop('OMP_WAIT_POLICY', None)
        importlib.import_module('torch')
    side = SIDES[name](options)
    pipe.send(side.samples)
    while pipe.recv():
        side.reset()
        start = time.perf_counter()
        losses = side.update()
        pipe.send((time.perf_counter() - start, losses))


class Served:
    """A side that runs in a process of its own."""

    def __init__(self, name: str, options: Options) -> None:
        context = multiprocessing.get_context('spawn')
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, name, options), daemon=True)
        self._process.start()
        theirs.close()
        self.samples: int = self._pipe.recv()

    def update(self) -> tuple[float, dict[str, float]]:
        """Run an update; return its duration, s, and its losses."""
        self._pipe.send(True)
        answer: tuple[float, dict[str, float]] = self._pipe.recv()
        return answer

    def close(self) -> None:
        """End the process."""
        self._pipe.send(False)
        self._process.join()
