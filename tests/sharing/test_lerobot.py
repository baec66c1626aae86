"""LeRobot is shown what the cameras see; its datasets repeat their episodes, and it makes and plays our environments.

What needs the package itself is skipped without it (`make test-lerobot` installs it).
"""

import sys
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import fake_reach
import gymnasium as gym
import numpy as np
import pytest
import torch as th
from gymnasium.utils.env_checker import check_env

from sb3_stereo.building.factory import make_env
from sb3_stereo.commands import collect as command
from sb3_stereo.config.components import Component
from sb3_stereo.errors import ConfigError
from sb3_stereo.sharing import lerobot_views
from sb3_stereo.sharing.formats import open_dataset
from sb3_stereo.sharing.lerobot_dataset import LeRobotRecorder, LeRobotWriter
from sb3_stereo.sharing.lerobot_env import LeRobotViews, env_file, has_env_file

NAME = "me/wam-reach"
TASK = "Reach the blue target with the red end effector."
ENV_ID = "WamStereoReach-v1"
N_EPISODES = 3
needs_lerobot = pytest.mark.skipif(find_spec("lerobot") is None, reason='pip install -e ".[lerobot]" (Python 3.12)')


class Wave:
    """Moves the joints to and fro."""

    step = 0

    def predict(self, observation: Any, *, deterministic: bool) -> tuple[Any, Any]:
        self.step += 1
        return np.float32([0.3, -0.2, 0.1, 0.4]) * (-1) ** self.step, None


def own_make_env(repo_id: str = NAME, env_id: str = ENV_ID, **env_kwargs: Any) -> Any:
    """`make_env` of a repository's `env.py`."""
    names: dict[str, Any] = {}
    exec(env_file(repo_id, env_id, env_kwargs), names)
    return names["make_env"]


# ------------------------------------------------------------------------------------------------ without the package
def test_the_state_is_where_the_pictures_show_the_markers() -> None:
    env = LeRobotViews(gym.make(ENV_ID, render_mode="rgb_array"))
    observation, info = env.reset(seed=5)
    assert observation in env.observation_space
    centres = observation["agent_pos"].reshape(2, 2, 2)  # view, marker, axis
    np.testing.assert_allclose(centres[:, 0] - centres[:, 1], info["pixel_offsets"], atol=1e-4)
    side_by_side = np.hstack([observation["pixels"]["left"], observation["pixels"]["right"]])
    np.testing.assert_array_equal(side_by_side, env.render())
    task: Any = env.unwrapped
    assert lerobot_views.state_names(task)[:3] == ["left.end_effector.x", "left.end_effector.y", "left.target.x"]
    env.close()


def test_a_lost_view_tells_nothing() -> None:
    env = LeRobotViews(gym.make(ENV_ID, lost_camera="left"))
    observation, info = env.reset(seed=5)
    assert np.isfinite(info["pixel_offsets"]).all(), "the judge still sees"
    assert (observation["agent_pos"][:4] == lerobot_views.UNSEEN).all() and not observation["pixels"]["left"].any()
    assert (observation["agent_pos"][4:] > 0).all()
    env.close()


@pytest.mark.filterwarnings("ignore:.*is different from the unwrapped version")  # it is a wrapper that is checked
@pytest.mark.parametrize("env_id", [ENV_ID, "WamStereoPick-v0"])
def test_what_lerobot_is_shown_is_an_environment(env_id: str) -> None:
    env = LeRobotViews(gym.make(env_id).unwrapped)
    check_env(env, skip_render_check=True)
    env.reset(seed=1)
    assert env.task_description == env.task
    env.close()


def test_a_picking_task_names_its_object() -> None:
    env = LeRobotViews(gym.make("WamStereoPick-v0", target={"shape": "bottle", "colour": "green"}))
    env.reset(seed=1)
    assert env.task_description == "Lift the green bottle with the suction cup."
    env.close()


def test_the_file_of_a_repository_makes_its_environment_and_takes_lerobots_reset() -> None:
    envs = own_make_env(max_episode_steps=7)(n_envs=2)
    ((suite, tasks),) = envs.items()
    vec_env = tasks[0]
    assert suite == ENV_ID and list(tasks) == [0] and vec_env.num_envs == 2
    observation, _ = vec_env.reset(seed=[1, 2], options={"lerobot_new_rollout": True})
    assert observation["pixels"]["left"].shape == (2, 240, 320, 3) and observation["agent_pos"].shape == (2, 8)
    assert vec_env.call("task_description") == vec_env.call("task") == (TASK, TASK)
    assert vec_env.call("_max_episode_steps") == (7, 7)
    with pytest.raises(ValueError, match="unknown reset option 'pose'"):
        vec_env.reset(options={"pose": 1})
    vec_env.close()


def test_lerobots_configuration_may_name_another_environment() -> None:
    envs = own_make_env(max_episode_steps=7)(cfg=SimpleNamespace(task="KukaStereoReach-v1"))
    vec_env = envs["KukaStereoReach-v1"][0]
    assert vec_env.call("_max_episode_steps") == (30,), "the arguments are the repository's own environment's"
    vec_env.close()
    assert list(own_make_env()(cfg=SimpleNamespace(task=None))) == [ENV_ID]


def test_processes_step_the_same_episodes() -> None:
    actions = np.float32([[0.3, -0.2, 0.1, 0.4], [-0.3, 0.2, 0.1, 0.0]])
    seen = []
    for use_async_envs in (False, True):
        (vec_env,) = own_make_env()(2, use_async_envs)[ENV_ID].values()
        vec_env.reset(seed=[1, 2])
        seen.append(vec_env.step(actions)[0])
        vec_env.close()
    np.testing.assert_array_equal(seen[0]["agent_pos"], seen[1]["agent_pos"])
    np.testing.assert_array_equal(seen[0]["pixels"]["right"], seen[1]["pixels"]["right"])


def test_only_our_environments_have_such_a_file() -> None:
    assert has_env_file(ENV_ID) and has_env_file("WamStereoPick-v0")
    assert not has_env_file(fake_reach.ENV_ID)


def test_a_frame_is_what_was_seen_before_its_action_and_what_came_of_it() -> None:
    recorder: Any = LeRobotRecorder(gym.make(ENV_ID, max_episode_steps=3))
    recorder.reset(seed=4)
    results = [recorder.step(Wave().predict(None, deterministic=True)[0]) for _ in range(3)]
    (episode,) = recorder.take()[1]
    again = gym.make(ENV_ID)
    _, info = again.reset(seed=4)
    for frame, (_, reward, *_) in zip(episode, results, strict=True):
        centres = frame["observation.state"].reshape(2, 2, 2)
        np.testing.assert_allclose(centres[:, 0] - centres[:, 1], info["pixel_offsets"], atol=1e-4)
        *_, info = again.step(frame["action"])
        assert frame["next.reward"][0] == np.float32(reward) and frame["next.success"][0] == info["is_success"]
        assert frame["task"] == TASK
    assert [bool(frame["next.done"][0]) for frame in episode] == [False, False, True]
    recorder.close()
    again.close()


def refusal(*args: Any) -> str:
    with pytest.raises(ConfigError) as caught:
        open_dataset("lerobot", *args)
    return str(caught.value)


def test_an_old_python_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "version_info", (3, 11, 7))
    message = refusal(NAME, "nobody")
    monkeypatch.undo()
    assert message == (
        "a LeRobot dataset needs Python 3.12 or newer, and this is 3.11.7; install sb3_stereo[lerobot] for a newer "
        "one, or take --format minari"
    )


def test_a_missing_package_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("huggingface_hub")
    monkeypatch.setattr("sb3_stereo.sharing.lerobot_dataset.OLDEST", (3, 10))
    monkeypatch.setitem(sys.modules, "lerobot.datasets.lerobot_dataset", None)
    monkeypatch.setitem(sys.modules, "lerobot", None)
    assert refusal(NAME, "nobody") == (
        'a LeRobot dataset needs lerobot; install it with: pip install "sb3_stereo[lerobot]"'
    )


def test_an_author_is_not_lerobots() -> None:
    assert refusal(NAME, "nobody", "me") == "--author is 'me', and a LeRobot dataset has none; leave it out"


RATE = "a LeRobot dataset has a whole number of frames a second; take 1 s or a half, a third, a quarter, ... of it"
REFUSED = [
    ({"pulse_duration": 0.3}, f"pulse_duration is 0.3 s, and {RATE}"),
    ({"cameras": ["left", "left"]}, "the cameras are left, left; LeRobot wants different names, without a /"),
]


@pytest.mark.parametrize(("kwargs", "message"), REFUSED)
def test_what_lerobot_cannot_have_is_refused_before_anything_is_played(kwargs: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        make_env(ENV_ID, kwargs, (Component(LeRobotWriter.recorder),))()
    assert str(caught.value) == message


def test_an_environment_without_cameras_is_refused() -> None:
    with pytest.raises(ConfigError, match="has no cameras whose pictures LeRobot could have; take an environment of"):
        LeRobotViews(gym.make(fake_reach.ENV_ID))


# ------------------------------------------------------------------------------------------------ with the package
@pytest.fixture
def datasets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where LeRobot's datasets are."""
    constants = pytest.importorskip("lerobot.utils.constants", reason='pip install -e ".[lerobot]"')
    monkeypatch.setattr(constants, "HF_LEROBOT_HOME", tmp_path / "lerobot")
    return tmp_path / "lerobot"


@pytest.fixture
def recorded(datasets: Path, capsys: pytest.CaptureFixture[str]) -> Any:
    """Episodes of the agent that ships, read back by LeRobot."""
    from lerobot.datasets import LeRobotDataset

    flags = ["--format", "lerobot", "--n-episodes", str(N_EPISODES), "--seed", "7", "--num-threads", "1"]
    assert command.main(["--dataset", NAME, *flags, "--device", "cpu"]) == 0
    assert capsys.readouterr().out.splitlines()[-2:] == [
        f"{N_EPISODES} episodes in the dataset {NAME}, {N_EPISODES} reached the target",
        f"Load it in Python with: lerobot.datasets.LeRobotDataset('{NAME}')",
    ]
    return LeRobotDataset(NAME, root=datasets / NAME)


@needs_lerobot
def test_a_dataset_repeats_its_episodes_to_the_bit(recorded: Any) -> None:
    from lerobot.datasets.dataset_metadata import CODEBASE_VERSION

    assert CODEBASE_VERSION == "v3.0" and recorded.meta.info.codebase_version == "v3.0"
    assert recorded.num_episodes == N_EPISODES and recorded.fps == 2 and recorded.meta.robot_type == ENV_ID
    assert recorded.features["action"]["names"] == ["J1", "J2", "J3", "J4"]
    env = LeRobotViews(gym.make(ENV_ID))
    index = 0
    for number in range(N_EPISODES):
        observation, _ = env.reset(seed=7 + number)
        ended = False
        while not ended:
            frame = recorded[index]
            assert frame["episode_index"] == number and frame["task"] == TASK
            for view, picture in observation["pixels"].items():
                stored = frame[f"observation.images.{view}"].permute(1, 2, 0).numpy() * 255
                np.testing.assert_array_equal(stored.round().astype(np.uint8), picture)
            np.testing.assert_array_equal(frame["observation.state"].numpy(), observation["agent_pos"])
            observation, reward, terminated, truncated, info = env.step(frame["action"].numpy())
            ended = terminated or truncated
            assert frame["next.reward"].item() == np.float32(reward)
            assert frame["next.success"].item() == info["is_success"] and frame["next.done"].item() == ended
            index += 1
    assert index == recorded.num_frames
    env.close()


@needs_lerobot
def test_lerobot_makes_the_environment_of_a_repository_and_its_rollout_reaches_the_target(
    recorded: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from lerobot.envs import make_env as make_hub_env
    from lerobot.envs import utils as lerobot_utils
    from lerobot.scripts.lerobot_eval import rollout

    file = tmp_path / "env.py"
    file.write_text(env_file(NAME, ENV_ID, {}))
    asked: list[tuple[str, str]] = []

    def download(repo_id: str, filename: str, **_: Any) -> str:
        asked.append((repo_id, filename))
        return str(file)

    monkeypatch.setattr(lerobot_utils, "hf_hub_download", download)
    envs = make_hub_env(NAME, n_envs=N_EPISODES, trust_remote_code=True)
    assert asked == [(NAME, "env.py")]
    actions = th.as_tensor(np.array(recorded.hf_dataset["action"]))
    ends = np.flatnonzero(np.array(recorded.hf_dataset["next.done"])) + 1
    episodes = [actions[begin:end] for begin, end in zip([0, *ends[:-1]], ends, strict=True)]
    played = th.nn.utils.rnn.pad_sequence(episodes, batch_first=True)  # (episodes, steps, joints)

    class Recorded(th.nn.Module):
        step = -1

        def reset(self) -> None: ...

        def select_action(self, observation: dict[str, Any]) -> th.Tensor:
            assert observation["observation.images.left"].shape == (N_EPISODES, 3, 240, 320)
            assert observation["observation.state"].shape == (N_EPISODES, 8) and observation["task"] == [TASK] * 3
            self.step += 1
            return played[:, min(self.step, played.shape[1] - 1)]

    def same(value: Any) -> Any:
        return value

    seeds = list(range(7, 7 + N_EPISODES))
    result = rollout(envs[ENV_ID][0], Recorded(), same, same, same, same, seeds=seeds)  # type: ignore[arg-type]
    for number, episode in enumerate(episodes):
        assert result["success"][number, len(episode) - 1], "where the episode ended"
        assert not result["success"][number, : len(episode) - 1].any()
    envs[ENV_ID][0].close()


@needs_lerobot
@pytest.mark.slow
def test_a_policy_of_lerobots_learns_the_actions(recorded: Any) -> None:
    from lerobot.configs import FeatureType
    from lerobot.policies.act.configuration_act import ACTConfig
    from lerobot.policies.act.modeling_act import ACTPolicy
    from lerobot.utils.feature_utils import dataset_to_policy_features

    features = dataset_to_policy_features(recorded.features)
    config = ACTConfig(
        input_features={key: ft for key, ft in features.items() if ft.type is not FeatureType.ACTION},
        output_features={key: ft for key, ft in features.items() if ft.type is FeatureType.ACTION},
        chunk_size=1,
        n_action_steps=1,
        dim_model=32,
        n_heads=2,
        dim_feedforward=64,
        n_encoder_layers=1,
        use_vae=False,
        dropout=0.0,
        pretrained_backbone_weights=None,
        device="cpu",
    )
    assert {key for key in config.input_features if "images" in key} == {
        "observation.images.left",
        "observation.images.right",
    }
    th.manual_seed(0)
    policy = ACTPolicy(config)
    frames = [recorded[index] for index in range(6)]
    batch = {key: th.stack([frame[key] for frame in frames]) for key in config.input_features}
    batch["observation.state"] = batch["observation.state"] / 160 - 1
    batch["action"] = th.stack([frame["action"] for frame in frames])[:, None]
    batch["action_is_pad"] = th.zeros(len(frames), 1, dtype=th.bool)
    optimizer = th.optim.Adam(policy.parameters(), lr=1e-3)
    losses = []
    for _ in range(20):
        loss, _ = policy.forward(batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.7 * losses[0], losses


@needs_lerobot
@pytest.mark.parametrize("name", ["wam", "a b/c", "../up", "", "me/a/b"])
def test_a_name_that_is_none_says_the_form(name: str, datasets: Path) -> None:
    form = "OWNER/NAME, of letters, digits, -, _ and ., e.g. me/wam-reach"
    assert refusal(name, "nobody") == f"--dataset is '{name}'; give {form}"
    assert not datasets.exists()


@needs_lerobot
def test_a_dataset_that_is_there_is_kept(datasets: Path) -> None:
    (datasets / NAME).mkdir(parents=True)
    folder = datasets / NAME
    assert refusal(NAME, "nobody") == f"there is a dataset '{NAME}' in '{folder}' already; choose another name"
