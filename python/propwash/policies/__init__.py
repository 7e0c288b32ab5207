"""Trained policies: what they observe, their network and what their actions mean in one file; exports as ONNX and as C; flights that
say how good they are. Needs nothing but NumPy, and Gymnasium where environments are flown.

>>> policy = propwash.Policy.from_torch(network, envs, inputs=[Input("difference_to_goal"), Input("vel").scale(0.5)])
>>> policy.save("reach.npz")
>>> print(propwash.evaluate("reach.npz", wind=(0.0, 2.0), delay=(0, 1)))
"""

from __future__ import annotations

from ._evaluate import Evaluation, EvaluationRow, evaluate
from ._inputs import Channel, Input
from ._layers import Layer
from ._policy import ActionSpec, Branch, Policy

__all__ = ["ActionSpec", "Branch", "Channel", "Evaluation", "EvaluationRow", "Input", "Layer", "Policy", "evaluate"]
