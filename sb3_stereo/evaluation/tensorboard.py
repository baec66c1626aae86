"""Images for TensorBoard at each evaluation: the camera views and the agent's saliency map."""

from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import TensorBoardOutputFormat

from sb3_stereo.evaluation.callback import PoseEvalCallback
from sb3_stereo.viz.drawing import capture, side_by_side, titled
from sb3_stereo.viz.saliency import overlaid, saliency

N_STATES = 4  # of an episode, from its start


class TensorboardPictures(BaseCallback):
    """Adds pictures of an episode from a sampled start whenever the agent has been scored.

    Nothing that is random in the training is touched. Comes after the scoring in the list of callbacks.

    Args:
        scoring: The callback that scores, whose environment and initial states are taken.
        seed: Of the initial states.
    """

    def __init__(self, scoring: PoseEvalCallback, seed: int = 0) -> None:
        super().__init__()
        self.scoring = scoring
        self.seed = seed
        self._seen = scoring.last

    def _on_training_start(self) -> None:
        """Measure how much each pixel changes from start to start; of a map of images no attention is drawn."""
        env = self.scoring.env_fn()
        initial_states = [env.reset(**start)[0] for start in self.scoring.initial_states]
        env.close()
        self.spread = None if isinstance(initial_states[0], dict) else np.std(initial_states, axis=0, dtype=np.float32)

    def _on_step(self) -> bool:
        if self.scoring.last is not self._seen:
            self._seen = self.scoring.last
            self.draw()
        return True

    def _on_training_end(self) -> None:
        self._on_step()

    def draw(self) -> None:
        """Play from a start and add the pictures of the first states."""
        stereo, attention = [], []
        env = self.scoring.env_fn()
        rng = np.random.default_rng((self.seed, self.scoring.num_timesteps))  # the same after a resumption
        observation, _ = env.reset(**self.scoring.initial_states[int(rng.integers(len(self.scoring.initial_states)))])
        for _ in range(N_STATES):
            if self.spread is not None:
                seen = overlaid(observation, saliency(self.model.policy, observation, self.spread))
                attention.append(titled("network input, and in red what changes the action most", seen))
            stereo += [side_by_side(capture(env))] if hasattr(env.unwrapped, "draw") else []
            action, _ = self.model.predict(observation, deterministic=True)
            observation, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                break
        env.close()
        for name, pictures in (("stereo", stereo), ("attention", attention)):
            if pictures:
                self._add(name, np.vstack(pictures))

    def _add(self, name: str, picture: Any) -> None:
        for output in self.logger.output_formats:
            if isinstance(output, TensorBoardOutputFormat):
                output.writer.add_image(f"pictures/{name}", picture, self.scoring.num_timesteps, dataformats="HWC")
                output.writer.flush()
