"""Two agents, of which the images say whose turn it is."""

from typing import Any

import numpy as np
import pytest

from sb3_stereo.building.factory import make_env
from sb3_stereo.envs.pick import StereoPickEnv
from sb3_stereo.evaluation.protocol import evaluate, random_initial_states
from sb3_stereo.policies.switched import SwitchedAgent, marker_distances


class Constant:
    """An agent that always acts alike, batch or not."""

    def __init__(self, value: float) -> None:
        self.value = value

    def predict(self, observation: Any, *, deterministic: bool = False) -> tuple[Any, Any]:
        shape = (7,) if observation.ndim == 3 else (len(observation), 7)
        return np.full(shape, self.value), None


@pytest.fixture(scope="module")
def observations() -> list[tuple[np.ndarray, float]]:
    """Of both phases' starts, with the environment's own distance."""
    found = []
    for phase in (None, "grasp"):
        env = StereoPickEnv(n_joints=6, composite="markers", phase=phase)
        for seed in range(6):
            observation, info = env.reset(seed=seed)
            found.append((observation, float(info["pixel_distances"].mean())))
        env.close()
    return found


def test_distances_in_observations_are_those_in_the_frames(observations: list[tuple[np.ndarray, float]]) -> None:
    seen = [(marker_distances(image), distance) for image, distance in observations if np.isfinite(distance)]
    assert len(seen) > 8
    for found, distance in seen:
        assert found == pytest.approx(distance, abs=4.0)


def test_the_near_one_grasps_and_the_far_one_reaches(observations: list[tuple[np.ndarray, float]]) -> None:
    agent = SwitchedAgent(Constant(1.0), Constant(2.0), near=50.0)
    for image, distance in observations:
        if abs(distance - 50.0) > 4.0 or np.isnan(distance):
            assert agent.predict(image)[0].tolist() == [2.0 if distance < 50.0 else 1.0] * 7
    batch = np.array([image for image, _ in observations])
    actions, state = agent.predict(batch, state="kept")
    assert state == "kept" and actions.shape == (len(batch), 7)
    np.testing.assert_array_equal(actions, [agent.predict(image)[0] for image in batch])


def test_a_hand_that_no_view_shows_is_far() -> None:
    blank = np.full((2, 84, 84), 128, np.uint8)
    assert np.isnan(marker_distances(blank))
    assert SwitchedAgent(Constant(1.0), Constant(2.0)).predict(blank)[0][0] == 1.0


def test_observations_without_markers_are_refused() -> None:
    with pytest.raises(ValueError) as error:
        SwitchedAgent(Constant(1.0), Constant(2.0)).predict(np.zeros((1, 84, 84), np.uint8))
    assert str(error.value) == "observations have shape (1, 84, 84); agents are switched with composite 'markers' only"


def test_a_distance_that_is_none_is_refused() -> None:
    with pytest.raises(ValueError) as error:
        SwitchedAgent(Constant(1.0), Constant(2.0), near=0.0)
    assert str(error.value) == "near is 0.0; give a positive number of pixels"


def test_switched_agents_are_evaluated_like_others() -> None:
    agent: Any = SwitchedAgent(Constant(0.1), Constant(0.2))
    env_fn = make_env("WamStereoPick-v0", {"composite": "markers", "max_episode_steps": 2}, ())
    score = evaluate(agent, env_fn, random_initial_states(2, seed=0))
    assert score.n_poses == 2 and score.success_rate == 0.0 and np.isnan(score.mean_q)
    assert score.mean_action == pytest.approx(0.1)
