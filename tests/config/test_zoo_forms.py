"""Hyper-parameters in the forms of rl-baselines3-zoo's files: 167 entries of ours in its proportions, 120 are accepted.

The zoo's published entries for our algorithms (ddpg, dqn, td3, sac, ppo, crossq, tqc) were counted by their forms; each
form below is written anew, with numbers of our own, as often as it occurs there.
"""

from typing import Any

import fake_reach
import pytest
import yaml

from sb3_stereo.config.schema import parse_config
from sb3_stereo.config.zoo_literals import parse_map
from sb3_stereo.errors import ConfigError

MLP = {"n_timesteps": 1e5, "policy": "MlpPolicy"}
TD3_NOISE = MLP | {"noise_type": "normal", "noise_std": 0.2, "gradient_steps": 1, "train_freq": 1}
SDE = {"use_sde": True, "learning_rate": "lin_6e-4", "ent_coef": "auto", "train_freq": 8, "gradient_steps": 8}
HER = {"replay_buffer_class": "HerReplayBuffer", "policy": "MultiInputPolicy"}
HER |= {"replay_buffer_kwargs": "dict( goal_selection_strategy='future', n_sampled_goal=3 )"}
PPO = MLP | {"n_envs": 8, "n_steps": 64, "batch_size": 32, "clip_range": "lin_0.3", "gae_lambda": 0.9}
WIDE = "dict(net_arch=dict(pi=[64, 64], qf=[128, 128]))"
GAUSSIAN = """dict(
  log_std_init=-1.5, ortho_init=False, activation_fn=nn.Tanh, net_arch=dict(pi=[32], vf=[32])
)"""

ACCEPTED: list[tuple[int, str, dict[str, Any]]] = [
    (20, "ddpg", TD3_NOISE | {"policy_kwargs": "dict(net_arch=[40, 30])"}),
    (21, "td3", TD3_NOISE | {"policy_kwargs": "dict(net_arch=[40, 30])", "batch_size": 64, "learning_starts": 1e3}),
    (
        4,
        "dqn",
        MLP | {"exploration_fraction": 0.1, "target_update_interval": 50, "policy_kwargs": "dict(net_arch=[64])"},
    ),
    (20, "sac", MLP | SDE | {"policy_kwargs": "dict(log_std_init=-2.5, net_arch=[40, 30])"}),
    (
        16,
        "tqc",
        MLP | SDE | {"top_quantiles_to_drop_per_net": 4, "policy_kwargs": "dict(use_expln=True, log_std_init=-2)"},
    ),
    (11, "tqc", MLP | HER | {"policy_kwargs": "dict(net_arch=[51, 51, 51], n_critics=2)"}),
    (16, "crossq", MLP | {"policy_kwargs": WIDE, "policy_delay": 2, "buffer_size": 5000}),
    (9, "ppo", PPO | {"n_epochs": 4, "ent_coef": 0.01, "max_grad_norm": 0.4, "policy_kwargs": GAUSSIAN}),
    (2, "ppo", PPO | {"frame_stack": 4}),
    (1, "ppo", PPO | {"normalize": False}),
]
REFUSED: list[tuple[int, str, dict[str, Any], str]] = [
    (
        44,
        "ppo",
        PPO | {"normalize": True},
        "normalize is not supported here; leave it out, and write env_wrapper: [gymnasium.wrappers.NormalizeReward] "
        "for rewards; our encoders normalise images",
    ),
    (
        3,
        "sac",
        MLP | {"env_wrapper": [{"a_wrapper_of_elsewhere.Skip": {"skip": 2}}]},
        "env_wrapper: cannot import 'a_wrapper_of_elsewhere.Skip' (No module named 'a_wrapper_of_elsewhere'); "
        "the form is package.module.Class",
    ),
]


def test_at_least_120_of_the_zoos_167_forms_are_accepted() -> None:
    for _, algo, values in ACCEPTED:
        as_read = yaml.safe_load(yaml.safe_dump(values))
        config = parse_config(algo, fake_reach.ENV_ID, as_read)
        assert parse_config(algo, fake_reach.ENV_ID, config.plain()) == config
    n_accepted, n_refused = sum(n for n, *_ in ACCEPTED), sum(n for n, *_ in REFUSED)
    assert n_accepted >= 120 and n_accepted + n_refused == 167


@pytest.mark.parametrize(("algo", "values", "message"), [entry[1:] for entry in REFUSED])
def test_what_cannot_be_used_is_refused_with_the_form_to_write(algo: str, values: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError) as error:
        parse_config(algo, fake_reach.ENV_ID, values)
    assert str(error.value) == message


def test_a_map_in_python_is_read_and_never_evaluated() -> None:
    assert parse_map("dict(a=-1, b=[1, (2.5, 'x')], c={'d': None}, e=th.optim.Adam, f=nn.ReLU)") == {
        "a": -1,
        "b": [1, [2.5, "x"]],
        "c": {"d": None},
        "e": "torch.optim.Adam",
        "f": "torch.nn.ReLU",
    }
    for text, reason in (
        ("dict(a=open('x'))", "'open('x')' is neither a constant nor a class of torch"),
        ("dict(a=os.path)", "'os.path' is neither a constant nor a class of torch"),
        ("dict(a=1+1)", "'1 + 1' is neither a constant nor a class of torch"),
        ("dict(**{})", "'dict(**{})' is neither a constant nor a class of torch"),
        ("[1]", "'[1]' is no map"),
        ("dict(", "'dict(' is no map"),
    ):
        with pytest.raises(ValueError) as error:
            parse_map(text)
        assert str(error.value) == reason
