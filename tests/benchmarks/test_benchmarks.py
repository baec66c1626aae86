"""The short measurements of `benchmarks/`, on sizes that take seconds."""

import numpy as np
import pytest
import torch as th

from benchmarks.analysis import generalisation, optimum, probe
from sb3_stereo.config.schema import load_config
from sb3_stereo.evaluation.protocol import eval_poses


def test_the_probe_reports_every_joint_and_both_markers() -> None:
    th.manual_seed(0)
    lines = probe.report(probe.collect(60, seed=0, random_target=True), n_updates=3)
    assert [line[:2] for line in lines[1:5]] == ["J1", "J2", "J3", "J4"]
    assert lines[5].startswith("mean error of the image position: end effector ")


def test_the_probe_reads_what_is_there() -> None:
    """On images that are the answer, R^2 is nearly 1."""
    rng = np.random.default_rng(0)
    joints = rng.uniform(-1, 1, (600, 2)).astype(np.float32)
    images = np.repeat(np.repeat(joints * 100 + 128, 42, axis=1)[:, None, :, None], 84, axis=3).astype(np.uint8)
    th.manual_seed(0)
    lines = probe.report(probe.Poses(images, joints, np.zeros((600, 8), np.float32)), n_updates=60)
    assert min(float(value) for value in lines[1].split()[1:]) > 0.9


def test_a_critic_that_has_seen_a_reward_knows_it() -> None:
    data = generalisation.collect(120, seed=0)
    assert data.observations.shape == (120, 1, 84, 84) and data.rewards.shape == (120,)
    policy_kwargs = dict(load_config("ddpg", "WamStereoReach-v0").policy_kwargs)
    before, _ = generalisation.fit_rewards(policy_kwargs, data, 120, n_updates=1)
    after, _ = generalisation.fit_rewards(policy_kwargs, data, 120, n_updates=150)
    assert after > max(before, 0.5)


@pytest.mark.parametrize(("displacement", "fewest"), [(0.3, 1), (1.6, 2)])
def test_the_planner_finds_the_way_back_to_the_target(displacement: float, fewest: int) -> None:
    planner = optimum.Planner("WamStereoReach-v0", {})
    pose = eval_poses("WamStereoReach-v0")[0] * 0.3
    _, info = planner.env.reset(options={"joint_positions": pose})
    planner.env._default_target = info["end_effector_position"]
    rng = np.random.default_rng(0)
    # J1 alone turns the end effector away; a full pulse turns it back by about a radian.
    start = {"options": {"joint_positions": pose - np.array([displacement, 0, 0, 0])}}
    assert planner.fewest_steps(start, rng) <= fewest


def test_what_is_collected_does_not_depend_on_the_number_of_workers() -> None:
    poses = [probe.collect_in_parallel(8, 0, False, n_workers).images for n_workers in (1, 3)]
    transitions = [generalisation.collect_in_parallel(8, 0, n_workers).observations for n_workers in (1, 3)]
    for one, three in (poses, transitions):
        assert len(one) == 8
        np.testing.assert_array_equal(one, three)
