"""The diagnosis of a run's networks, on policies and runs that were not trained."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import torch as th
from gymnasium.spaces import Box, Discrete

from benchmarks.analysis import diagnosis
from benchmarks.analysis.diagnosis import BATCH_NORMS, Gap, QStatistics, compare_statistics, look_at
from sb3_stereo.config.schema import load_config
from sb3_stereo.policies.ddpg import StereoDDPGPolicy
from sb3_stereo.policies.dqn import StereoDQNPolicy
from sb3_stereo.runs.creation import create_run
from sb3_stereo.runs.models import save_model, untrained_model

BATCH_SIZE = 50
IMAGES = list(np.random.default_rng(0).integers(0, 256, (2 * BATCH_SIZE, 1, 84, 84), dtype=np.uint8))


def make_policy(norm: str = "batch") -> StereoDDPGPolicy:
    th.manual_seed(0)
    extractor = {"input_norm": "none" if norm == "none" else "channel"}
    spaces = Box(0, 255, (1, 84, 84), np.uint8), Box(-1, 1, (4,))
    return StereoDDPGPolicy(
        *spaces,
        lambda _: 1e-4,
        actor_hidden_norm=norm,
        critic_hidden_norm=norm,
        features_extractor_kwargs=extractor,
        final_init=1.0,
    )


def test_without_batch_norm_there_is_no_gap() -> None:
    gap = compare_statistics(make_policy("none"), IMAGES, BATCH_SIZE)
    assert gap.q_gap == gap.action_gap == 0.0
    assert gap.q_batch == gap.q_running and gap.action_batch == gap.action_running > 0


def test_running_statistics_of_the_same_images_close_the_gap() -> None:
    policy = make_policy()
    before = compare_statistics(policy, IMAGES[:BATCH_SIZE], BATCH_SIZE)
    assert min(before.q_gap, before.action_gap) > 0.1
    for norm in policy.modules():
        if isinstance(norm, BATCH_NORMS):
            norm.momentum = 1.0
    policy.set_training_mode(True)
    tensors, _ = policy.obs_to_tensor(np.stack(IMAGES[:BATCH_SIZE]))
    with th.no_grad():
        policy.critic(tensors, policy.actor(tensors))
    after = compare_statistics(policy, IMAGES[:BATCH_SIZE], BATCH_SIZE)
    assert after.q_gap < 0.1 * before.q_gap and after.action_gap < 0.1 * before.action_gap


def test_to_look_changes_nothing() -> None:
    policy = make_policy()
    before = {name: value.clone() for name, value in policy.state_dict().items() if "num_batches" not in name}
    first = compare_statistics(policy, IMAGES, BATCH_SIZE)
    assert all(th.equal(value, policy.state_dict()[name]) for name, value in before.items())
    assert not any(module.training for module in policy.modules())
    assert compare_statistics(policy, IMAGES, BATCH_SIZE) == first


def test_a_dead_network_sees_nothing() -> None:
    th.manual_seed(0)
    policy = StereoDQNPolicy(Box(0, 255, (1, 84, 84), np.uint8), Discrete(81), lambda _: 1e-4)
    alive = look_at(policy, IMAGES)
    assert alive.q_spread > 0 and alive.live_features > 0.3 and alive.actions > 1
    with th.no_grad():
        policy.q_net.features_extractor.fc[0].bias.fill_(-1e3)  # every ReLU is off
    dead = look_at(policy, IMAGES)
    assert dead.q_spread == pytest.approx(0.0, abs=1e-6) and dead.live_features == 0.0 and dead.actions == 1


def make_run(logs: Path, algo: str, steps: Sequence[int]) -> Path:
    """A run with the paper's networks and untrained checkpoints."""
    config = load_config(algo, "WamStereoReach-v0", f"hyperparams/paper/{algo}.yml")
    run = create_run(logs, config, {"algo": algo, "env": config.env_id, "seed": 0})
    for step in steps:
        save_model(untrained_model(config, "cpu", seed=step), run / f"rl_model_{step}_steps.zip")
    return run


@pytest.mark.parametrize(("algo", "measured"), [("ddpg", Gap), ("dqn", QStatistics)])
def test_every_checkpoint_has_a_line(
    algo: str, measured: type[Gap | QStatistics], logs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [str(make_run(logs, algo, (2000, 1000))), "--poses", "10", "--batch-size", "5"]
    assert diagnosis.main([*arguments, "--json"]) == 0
    lines = json.loads(capsys.readouterr().out)
    assert [line.pop("timesteps") for line in lines] == [1000, 2000]
    assert all(set(line) == set(measured._fields) for line in lines)
    assert diagnosis.main(arguments) == 0
    header, _, *table = capsys.readouterr().out.splitlines()
    assert header == f"| {' | '.join(('timesteps', *measured._fields))} |"
    assert [row.split(" | ")[0] for row in table] == ["| 1000", "| 2000"]


def test_what_cannot_be_diagnosed_is_an_error(logs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = make_run(logs, "ddpg", ())
    assert diagnosis.main([str(run)]) == 2
    assert capsys.readouterr().err == f"error: no checkpoints in '{run}'; train with --save-freq\n"
    assert diagnosis.main([str(run), "--poses", "9"]) == 2
    expected = "error: --batch-size must be at least 2 and at most --poses, and --seed not negative, got 100, 9 and 0\n"
    assert capsys.readouterr().err == expected
