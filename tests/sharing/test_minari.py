"""A recorded dataset repeats its episodes in the environment that it names, and an agent can be cloned from it."""

import sys
from pathlib import Path
from typing import Any

import fake_reach
import gymnasium as gym
import numpy as np
import pytest
import torch as th
from tiny_training import QUICK, tiny_config

from sb3_stereo.building.factory import make_env
from sb3_stereo.commands import collect as command
from sb3_stereo.config.components import Component
from sb3_stereo.errors import ConfigError
from sb3_stereo.policies.extractors import StereoCnn
from sb3_stereo.sharing.minari_dataset import MinariRecorder, MinariWriter, columns
from sb3_stereo.sharing.recording import collect
from sb3_stereo.training.trainer import Options, train

minari = pytest.importorskip("minari", reason='pip install -e ".[dataset]"')
NAME = "fake/reach-v0"
QUANTISED = Component("sb3_stereo.envs.wrappers.QuantizedActions", {"levels": 3})


@pytest.fixture(autouse=True)
def datasets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the datasets are."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "datasets"))
    return tmp_path / "datasets"


class Expert:
    """Moves the joint that the brightness stands for towards the goal."""

    def predict(self, observation: Any, *, deterministic: bool) -> tuple[Any, Any]:
        joint = (float(observation.mean()) - 127) / 60
        return np.clip(np.array([-2 * joint, 0, 0, 0], np.float32), -1, 1), None


class Turns:
    """Takes every discrete action in turn."""

    action = 0

    def predict(self, observation: Any, *, deterministic: bool) -> tuple[Any, Any]:
        self.action = (self.action + 7) % 81
        return np.int64(self.action), None


def recorded(env_id: str, *wrappers: Component, **kwargs: Any) -> gym.Env[Any, Any]:
    return make_env(env_id, kwargs, (Component(MinariWriter.recorder), *wrappers))()


def assert_repeats(made: Any, env: gym.Env[Any, Any]) -> None:
    """Every episode, from its seed and its actions, to the bit."""
    for number, episode in enumerate(made.iterate_episodes()):
        seed = next(iter(made.storage.get_episode_metadata([number])))["seed"]
        observation, info = env.reset(seed=seed)
        shown, infos = [observation], [info]
        for t, action in enumerate(episode.actions):
            observation, reward, terminated, truncated, info = env.step(action)
            shown.append(observation)
            infos.append(info)
            assert reward == episode.rewards[t]
            assert (terminated, truncated) == (episode.terminations[t], episode.truncations[t])
        assert terminated or truncated
        assert_same(columns(shown), episode.observations)
        assert set(episode.infos) == set(infos[0])
        for key, values in episode.infos.items():
            np.testing.assert_array_equal(values, np.array([info[key] for info in infos]))


def assert_same(one: Any, other: Any) -> None:
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for key in one:
            assert_same(one[key], other[key])
    else:
        np.testing.assert_array_equal(one, other)


def test_the_actions_repeat_the_episodes_in_the_environment_that_the_dataset_names(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(MinariWriter, "batch", 3)
    env = recorded(fake_reach.ENV_ID, tolerance=0.2)
    collect(Expert(), env, MinariWriter(NAME, "expert", "me"), n_episodes=8, seed=3)
    made = minari.load_dataset(NAME)
    assert made.total_episodes == 8
    assert [data["seed"] for data in made.storage.get_episode_metadata(range(8))] == list(range(3, 11))
    again = made.recover_environment()
    assert again.unwrapped.tolerance == 0.2
    assert_repeats(made, again)
    assert made.storage.metadata["author"] == {"me"} and made.storage.metadata["algorithm_name"] == "expert"


def test_the_agents_wrappers_are_not_part_of_it() -> None:
    env = recorded(fake_reach.ENV_ID, QUANTISED)
    collect(Turns(), env, MinariWriter(NAME, "turns"), n_episodes=3)
    made = minari.load_dataset(NAME)
    assert made.action_space == gym.make(fake_reach.ENV_ID).action_space
    assert set(np.unique(made[0].actions)) <= {-1.0, 0.0, 1.0}
    assert_repeats(made, made.recover_environment())


@pytest.mark.parametrize("composite", ["stack", "dict"])
def test_a_simulated_arm_repeats_them_too(composite: str) -> None:
    class Still:
        def predict(self, observation: Any, *, deterministic: bool) -> tuple[Any, Any]:
            return np.full(4, 0.3, np.float32), None

    env = recorded("WamStereoReach-v1", composite=composite, max_episode_steps=3)
    collect(Still(), env, MinariWriter(NAME, "still"), n_episodes=2)
    made = minari.load_dataset(NAME)
    again = made.recover_environment()
    assert_repeats(made, again)
    env.close()
    again.close()


def test_an_agent_cloned_from_a_dataset_reaches_the_goal() -> None:
    writer = MinariWriter(NAME, "expert")
    collect(Expert(), recorded(fake_reach.ENV_ID), writer, n_episodes=40)
    assert writer.n_episodes == writer.n_successes == 40
    episodes = list(minari.load_dataset(NAME).iterate_episodes())
    images = th.as_tensor(np.concatenate([episode.observations[:-1] for episode in episodes]))
    actions = th.as_tensor(np.concatenate([episode.actions for episode in episodes]))
    th.manual_seed(0)
    space = gym.make(fake_reach.ENV_ID).observation_space
    net = th.nn.Sequential(StereoCnn(space, features_dim=16, n_filters=4), th.nn.Linear(16, 4), th.nn.Tanh())
    optimizer = th.optim.Adam(net.parameters(), lr=3e-3)
    for _ in range(150):
        loss = (net(images.float() / 255) - actions).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    net.eval()

    class Clone:
        def predict(self, observation: Any, *, deterministic: bool) -> tuple[Any, Any]:
            with th.no_grad():
                return net(th.as_tensor(observation[None]).float() / 255)[0].numpy(), None

    tested = MinariWriter("fake/clone-v0", "clone")
    collect(Clone(), recorded(fake_reach.ENV_ID), tested, n_episodes=20, seed=1000)
    assert tested.n_successes >= 19


def test_the_agent_that_ships_plays_by_default(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["--dataset", NAME, "--n-episodes", "2", "--num-threads", "1", "--device", "cpu"]) == 0
    assert capsys.readouterr().out.startswith("2 episodes in the dataset fake/reach-v0, 2 reached the target\n")
    made = minari.load_dataset(NAME)
    assert made.env_spec.id == "WamStereoReach-v1" and made.total_episodes == 2
    assert_repeats(made, made.recover_environment())


def test_a_run_is_played_too(logs: Path) -> None:
    run = train(tiny_config(), Options(seed=1, log_folder=str(logs), device="cpu", verbose=0)).run
    assert command.main([str(run), "--dataset", NAME, "--n-episodes", "2", "--stochastic", *QUICK]) == 0
    assert minari.load_dataset(NAME).storage.metadata["algorithm_name"] == "DDPG"


def refusal(name: str) -> str:
    with pytest.raises(ConfigError) as caught:
        MinariWriter(name, "nobody")
    return str(caught.value)


@pytest.mark.parametrize("name", ["reach", "a b-v0", "../up-v0", "", "reach-v"])
def test_a_name_that_is_none_says_the_form(name: str, datasets: Path) -> None:
    form = "NAME-vN or GROUP/NAME-vN, of letters, digits, - and _, e.g. wam/reach-v0"
    assert refusal(name) == f"--dataset is '{name}'; give {form}"
    assert not datasets.exists()


def test_a_dataset_that_is_there_is_kept(datasets: Path) -> None:
    collect(Expert(), recorded(fake_reach.ENV_ID), MinariWriter(NAME, "expert"), n_episodes=1)
    assert refusal(NAME) == (
        f"there is a dataset '{NAME}' in '{datasets / NAME}' already; choose another name, such as a next version"
    )


def test_an_episode_that_has_not_ended_is_left_out() -> None:
    env = MinariRecorder(gym.make(fake_reach.ENV_ID, tolerance=1e-9))
    env.reset(seed=1)
    env.step(np.zeros(4, np.float32))
    env.reset(seed=2)
    for _ in range(fake_reach.MAX_STEPS):
        env.step(np.zeros(4, np.float32))
    (episode,) = env.take()[1]
    assert episode.seed == 2 and len(episode) == fake_reach.MAX_STEPS and episode.truncations[-1]
    assert env.take()[1] == []


@pytest.mark.parametrize("missing", ["minari", "h5py"])
def test_a_missing_package_is_named_with_its_extra(missing: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, missing if missing == "h5py" else "minari.dataset.minari_dataset", None)
    assert refusal(NAME) == (
        f'a dataset needs {missing} (Python 3.11 or newer); install it with: pip install "sb3_stereo[dataset]"'
    )
