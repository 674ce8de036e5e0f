# SPDX-License-Identifier: Apache-2.0
"""The whole way from an observation to the action as one ONNX graph."""
from __future__ import annotations

import contextlib
import copy
import io
import logging
import warnings
from typing import Any

import torch
from torch import Tensor
from torch import nn

from ppo_agent_node.pilots.onnx_file import INPUT
from ppo_agent_node.pilots.onnx_file import OUTPUT
from ppo_agent_node.ppo.policies.factory import Policy
from rocket_sim_node.worlds import WorldSpec

OPSET = 20
"""Version of ONNX's operators."""


class DeterministicPolicy(nn.Module):
    """Features, normaliser, network and most likely action, without what depends on the data.

    Continuous actions are clipped to their bounds, as worlds do.
    """

    bends: Tensor
    width: Tensor
    low: Tensor
    high: Tensor

    def __init__(self, policy: Policy, spec: WorldSpec) -> None:
        """Take over the weights of a policy for a world."""
        super().__init__()
        self.normaliser, self.network = copy.deepcopy(policy.normaliser), policy.network
        if self.normaliser.features is not None:
            # ONNX has Asinh, but no Log1p, without which small numbers would lose digits.
            self.normaliser.features.compress = torch.asinh
        width = policy.normaliser.width
        self.register_buffer('bends', width > 0)
        self.register_buffer('width', torch.where(width > 0, width, torch.ones_like(width)))
        self.continuous = spec.continuous
        self.register_buffer('low', torch.tensor(spec.action_low, dtype=torch.float32))
        self.register_buffer('high', torch.tensor(spec.action_high, dtype=torch.float32))

    def output(self, observation: Tensor) -> Tensor:
        """Return clipped actions `(N, A)`, or logits `(N, K)`, of observations `(N, D)`."""
        x = torch.where(self.bends, torch.asinh(observation / self.width), observation)
        features = self.normaliser.features
        if features is not None:
            x = torch.cat((x, features(observation)), -1)
        x = (x - self.normaliser.mean) * self.normaliser.scale
        for layer in self.network:
            x = layer(x)
        if self.continuous:
            return torch.minimum(torch.maximum(x, self.low), self.high)
        return x

    def forward(self, observation: Tensor) -> Tensor:
        """Return actions `(N, A)` float32, or `(N,)` int64, of observations `(N, D)`.

        Observations or logits that are not finite give action -1.
        """
        output = self.output(observation)
        if self.continuous:
            return output
        # The largest of numbers that are not finite is none; worlds and our pilot refuse -1.
        finite = (observation - observation == 0).all(-1) & (output - output == 0).all(-1)
        return torch.where(finite, output.argmax(-1), -1)


def to_onnx(policy: Policy, spec: WorldSpec) -> Any:
    """Return the policy as an `onnx.ModelProto`: float32 `(batch, D)` to its action.

    :raises ModuleNotFoundError: where a package of the extra `export` is missing.
    """
    module = DeterministicPolicy(policy, spec).eval()
    example = torch.zeros(2, spec.observation_size)
    # The exporter logs and warns about itself.
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()), _quiet():
        warnings.simplefilter('ignore')
        program = torch.onnx.export(
            module, (example,), None, input_names=[INPUT], output_names=[OUTPUT],
            dynamic_shapes=({0: torch.export.Dim('batch')},), opset_version=OPSET,
            external_data=False, dynamo=True, verbose=False)
    assert program is not None
    model = program.model_proto
    # Else it holds the paths and the lines of the program that wrote it.
    for node in model.graph.node:
        node.ClearField('doc_string')
        node.ClearField('metadata_props')
    for value in (*model.graph.value_info, *model.graph.input, *model.graph.output,
                  *model.graph.initializer):
        value.ClearField('metadata_props')
        value.ClearField('doc_string')
    model.graph.ClearField('metadata_props')
    model.ClearField('metadata_props')
    model.doc_string = ''
    return model


@contextlib.contextmanager
def _quiet() -> Any:
    """Keep messages below errors from being logged."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        yield
    finally:
        logging.disable(before)
