"""A sweep that is trained in seconds, and its YAML with changes."""

from pathlib import Path
from typing import Any

import fake_reach
import yaml

from sb3_stereo.tuning.config import Sweep, load_sweep

BASE = {
    "env": fake_reach.ENV_ID,
    "n_timesteps": 30,
    "eval_freq": 15,
    "seeds": [3, 5],
    "method": "grid",
    "metric": {"name": "eval/mean_steps_capped", "goal": "minimize"},
    "parameters": {"gamma": {"values": [0.5, 0.9]}},
}
# So small that a trial takes less than a second.
CHEAP = {"n_timesteps": 30, "policy": "MlpPolicy", "policy_kwargs": {"net_arch": [8]}}
CHEAP |= {"learning_starts": 10, "batch_size": 4, "buffer_size": 50}
RANGES = {"gamma": {"min": 0.5, "max": 0.9}}


def write(tmp_path: Path, **changes: Any) -> Path:
    """Write the tiny sweep with changes; None leaves a key out."""
    content = {key: value for key, value in (BASE | changes).items() if value is not None}
    file = tmp_path / "tiny.yml"
    file.write_text(yaml.safe_dump(content))
    return file


def load(tmp_path: Path, **changes: Any) -> Sweep:
    return load_sweep(write(tmp_path, **changes))


def load_cheap(tmp_path: Path, **changes: Any) -> Sweep:
    (tmp_path / "cheap.yml").write_text(yaml.safe_dump({"default": CHEAP}))
    return load(tmp_path, conf_file="cheap.yml", **changes)
