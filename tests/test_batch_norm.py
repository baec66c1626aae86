"""The comparison of batch statistics with running ones, on policies and runs that were not trained."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch as th
from gymnasium.spaces import Box

from benchmarks import batch_norm
from benchmarks.batch_norm import BATCH_NORMS, Line, compare
from sb3_stereo.config import load_config
from sb3_stereo.models import save_model, untrained_model
from sb3_stereo.policies import StereoDDPGPolicy
from sb3_stereo.runs import create_run, save_records

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
    means = compare(make_policy("none"), IMAGES, BATCH_SIZE)
    assert means["q_gap"] == means["action_gap"] == 0.0
    assert means["q_batch"] == means["q_running"] and means["action_batch"] == means["action_running"] > 0


def test_running_statistics_of_the_same_images_close_the_gap() -> None:
    policy = make_policy()
    before = compare(policy, IMAGES[:BATCH_SIZE], BATCH_SIZE)
    assert min(before["q_gap"], before["action_gap"]) > 0.1
    for norm in policy.modules():
        if isinstance(norm, BATCH_NORMS):
            norm.momentum = 1.0
    policy.set_training_mode(True)
    tensors, _ = policy.obs_to_tensor(np.stack(IMAGES[:BATCH_SIZE]))
    with th.no_grad():
        policy.critic(tensors, policy.actor(tensors))
    after = compare(policy, IMAGES[:BATCH_SIZE], BATCH_SIZE)
    assert after["q_gap"] < 0.1 * before["q_gap"] and after["action_gap"] < 0.1 * before["action_gap"]


def test_to_look_changes_nothing() -> None:
    policy = make_policy()
    before = {name: value.clone() for name, value in policy.state_dict().items() if "num_batches" not in name}
    first = compare(policy, IMAGES, BATCH_SIZE)
    assert all(th.equal(value, policy.state_dict()[name]) for name, value in before.items())
    assert not any(module.training for module in policy.modules())
    assert compare(policy, IMAGES, BATCH_SIZE) == first


@pytest.fixture
def run(logs: Path) -> Path:
    """A run with the paper's networks and no checkpoints."""
    config = load_config("ddpg", "WamStereoReach-v0", "hyperparams/paper/ddpg.yml")
    run = create_run(logs, "ddpg", config.env_id)
    save_records(run, config, {"algo": "ddpg", "env": config.env_id, "seed": 0})
    return run


def test_every_checkpoint_has_a_line(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config, _ = batch_norm.load_record(run)
    for step in (2000, 1000):
        save_model(untrained_model(config, "cpu", seed=step), run / f"rl_model_{step}_steps.zip")
    assert batch_norm.main([str(run), "--poses", "10", "--batch-size", "5", "--json"]) == 0
    lines = [Line(**line) for line in json.loads(capsys.readouterr().out)]
    assert [line.timesteps for line in lines] == [1000, 2000]
    assert batch_norm.main([str(run), "--poses", "10", "--batch-size", "5"]) == 0
    header, _, *table = capsys.readouterr().out.splitlines()
    assert header.split("|")[1:-1] == [f" {name} " for name in Line._fields]
    assert [float(row.split("|")[1]) for row in table] == [1000, 2000]


def test_what_cannot_be_compared_is_an_error(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert batch_norm.main([str(run)]) == 2
    assert capsys.readouterr().err == f"error: no checkpoints in '{run}'; train with --save-freq\n"
    assert batch_norm.main([str(run), "--poses", "9"]) == 2
    expected = "error: --batch-size must be at least 2 and at most --poses, and --seed not negative, got 100, 9 and 0\n"
    assert capsys.readouterr().err == expected
