"""Where an agent looks: how much each pixel of an image changes what it does."""

from typing import Any

import cv2
import numpy as np
import torch as th
from numpy.typing import NDArray
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.preprocessing import preprocess_obs
from stable_baselines3.td3.policies import Actor

from sb3_stereo.envs.composite import as_stack
from sb3_stereo.policies.shared_encoder import SharedEncoderView

Image = NDArray[np.uint8]


def saliency(policy: BasePolicy, observation: Image, spread: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return how much a usual change of each pixel changes the action; for Q-networks, max Q.

    It is the length of the gradient times the spread. The gradient alone is large also for pixels that never change:
    in training nothing kept it small there.

    Args:
        policy: Of DDPG, TD3, DQN, or any other whose deterministic action has a gradient.
        observation: Image (channels, height, width), uint8.
        spread: Standard deviation of every pixel over observations, (channels, height, width).

    Returns:
        As one image (rows, columns), see `as_stack`, from 0 to 1; all 0 where no pixel counts.
    """
    policy.set_training_mode(False)
    image = th.as_tensor(observation[None], dtype=th.float32, device=policy.device).requires_grad_()
    with th.enable_grad():
        outputs = _outputs(policy, image)[0]  # (n_outputs,)
        gradients = [th.autograd.grad(output, image, retain_graph=True)[0][0] for output in outputs]
    changes = th.stack(gradients).cpu().numpy() * spread
    length = as_stack(np.sqrt(np.square(changes).sum(axis=0)))[0]  # over outputs
    return np.asarray(length / max(length.max(), 1e-30), np.float32)


def _outputs(policy: Any, image: th.Tensor) -> th.Tensor:
    """What the agent does (1, n_outputs), with its gradient to the image (1, channels, height, width)."""
    if hasattr(policy, "q_net"):
        values: th.Tensor = policy.q_net(image).max(dim=1, keepdim=True).values
        return values
    if isinstance(getattr(policy, "actor", None), Actor):
        encoder = policy.actor.features_extractor
        encoder = encoder.encoder if isinstance(encoder, SharedEncoderView) else encoder
        scaled = preprocess_obs(image, policy.observation_space, normalize_images=policy.normalize_images)
        actions: th.Tensor = policy.actor.mu(encoder(scaled))
        return actions
    actions = policy._predict(image, deterministic=True)
    return actions


def overlaid(observation: Image, attention: NDArray[np.float32], factor: int = 5) -> Image:
    """Lay the attention in red over a grey image, enlarged, and put it beside the image alone.

    Args:
        observation: Image (channels, height, width), uint8; channels are laid out as by `as_stack`.
        attention: As from `saliency`.
        factor: Of the enlargement.

    Returns:
        RGB, (factor * rows, 2 * factor * columns, 3).
    """
    grey = np.repeat(as_stack(observation)[0, :, :, None], 3, axis=2).astype(np.float32)
    share = attention[:, :, None]
    mixed = (1 - share) * (0.5 * grey + 127) + share * np.array([220.0, 0.0, 0.0])
    both = np.hstack([grey, mixed]).astype(np.uint8)
    return np.asarray(cv2.resize(both, None, fx=factor, fy=factor, interpolation=cv2.INTER_NEAREST), np.uint8)
