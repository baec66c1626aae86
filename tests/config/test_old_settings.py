"""Settings under the names of version 0.0 are today's settings, with a hint."""

from typing import Any

import pytest

from sb3_stereo.config.schema import load_config, parse_config
from sb3_stereo.errors import ConfigError

OLD: dict[str, Any] = {
    "n_timesteps": 9,
    "policy": "sb3_stereo.StereoDDPGPolicy",
    "policy_kwargs": {"shared_encoder": True, "encoder_loss": "motion"},
    "callback": [
        {"sb3_stereo.AnnealExploration": {"n_steps": 50, "final_epsilon": 0.2}},
        {"sb3_stereo.buffers.StereoReplay": {"goal_share": 0.3}},
        {"sb3_stereo.motion.LearnFromMotion": {"replay_ratio": 5}},
        {"sb3_stereo.WarmUp": {"replay_ratio": 7}},
        "stable_baselines3.common.callbacks.ProgressBarCallback",
    ],
}
NEW: dict[str, Any] = {
    "n_timesteps": 9,
    "policy": "sb3_stereo.StereoDDPGPolicy",
    "policy_kwargs": {"shared_encoder": True, "encoder_loss": "dynamics"},
    "callback": ["stable_baselines3.common.callbacks.ProgressBarCallback"],
    "exploration": {"n_steps": 50, "final_epsilon": 0.2},
    "replay_buffer_kwargs": {"success_fraction": 0.3},
    "dynamics_steps": 2,
    "pretraining": {"dynamics": 5, "agent": 7},
}


def parsed(values: dict[str, Any], algo: str = "ddpg") -> Any:
    return parse_config(algo, "WamStereoReach-v0", values)


def test_callbacks_of_old_files_and_runs_are_settings() -> None:
    with pytest.warns(FutureWarning, match=r"^'callback: WarmUp' is called 'pretraining.agent' since version 0.1.0"):
        assert parsed(OLD) == parsed(NEW)


def test_dqns_encoder_learns_from_both_losses_as_before() -> None:
    old = {**OLD, "policy": "sb3_stereo.StereoDQNPolicy", "policy_kwargs": {}}
    with pytest.warns(FutureWarning):
        assert parsed(old, "dqn").policy_kwargs == {"encoder_loss": "critic+dynamics"}


def test_old_keys_override_todays_files() -> None:
    with pytest.warns(FutureWarning, match=r"^'callback.WarmUp.replay_ratio' is called 'pretraining.agent' since"):
        config = load_config("ddpg", "WamStereoReach-v0", params={"callback.WarmUp.replay_ratio": 1})
    assert config.algo_kwargs["pretraining"] == {"dynamics": 3, "agent": 1}


def test_what_has_no_present_name_is_refused() -> None:
    with pytest.raises(ConfigError) as error:
        parsed({**OLD, "callback": [{"sb3_stereo.LearnFromMotion": {"batch_size": 9}}]})
    assert str(error.value) == (
        "callback LearnFromMotion has no 'batch_size' any more; its settings are dynamics_steps, "
        "policy_kwargs.dynamics_learning_rate, pretraining.dynamics now"
    )
