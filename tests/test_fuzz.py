"""Whatever comes in, the answer is a documented error in one sentence, or it works: never a traceback, a hang or a NaN.

The cases are drawn by Hypothesis, always the same ones; together they are more than two thousand.
"""

from pathlib import Path
from typing import Any

import fake_reach
import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sb3_stereo import train as train_cli
from sb3_stereo import training
from sb3_stereo.config import Config, load_config, parse_config
from sb3_stereo.envs.reach import StereoReachEnv
from sb3_stereo.errors import ConfigError
from sb3_stereo.training import Result

ROOT = Path(__file__).parent.parent
SAME_EVERY_TIME = {"derandomize": True, "deadline": None, "database": None}
FIXTURES_ARE_FINE = {"suppress_health_check": [HealthCheck.function_scoped_fixture, HealthCheck.too_slow]}

scalars = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.integers(-3, 3)
    | st.floats()
    | st.text(max_size=8)
    | st.sampled_from(["lin_1", "lin_", "pixel", "CnnPolicy", "os.system", "sb3_stereo.nothing.At", "1e-3", "auto"])
)
values = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8) | st.integers(), inner, max_size=3),
    max_leaves=6,
)
OURS = load_config("ddpg", fake_reach.ENV_ID).plain()
keys = st.sampled_from([*OURS, *OURS["policy_kwargs"], "verbose", "seed"]) | st.text(max_size=8)


def check_sentence(message: str) -> None:
    """One line that says something; what it quotes of the input is quoted safely."""
    assert message.strip()
    assert len(message.splitlines()) == 1, message


@settings(max_examples=600, **SAME_EVERY_TIME)
@given(st.sampled_from(["ddpg", "dqn", "td3"]), st.dictionaries(keys, values, max_size=3))
def test_any_hyperparameters_are_a_configuration_or_one_sentence(algo: str, changes: dict[str, Any]) -> None:
    try:
        config = parse_config(algo, fake_reach.ENV_ID, OURS | changes)
    except ConfigError as error:
        check_sentence(str(error))
    else:
        assert isinstance(config, Config)
        assert parse_config(algo, fake_reach.ENV_ID, config.plain()) == config or _has_nan(changes)


def _has_nan(value: Any) -> bool:
    return "nan" in repr(value)


@settings(max_examples=400, **SAME_EVERY_TIME, **FIXTURES_ARE_FINE)
@given(text=st.text(max_size=60) | values.map(yaml.safe_dump) | st.binary(max_size=40))
def test_any_file_is_hyperparameters_or_one_sentence(text: str | bytes, tmp_path: Path) -> None:
    file = tmp_path / "any.yml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass"))
    with pytest.raises(ConfigError) as error:
        load_config("ddpg", fake_reach.ENV_ID, file)
    check_sentence(str(error.value))


FLAGS = [
    *("--algo", "--env", "-f", "-n", "--seed", "-conf", "-params", "--env-kwargs", "--vec-env", "--eval-freq"),
    *("--n-eval-envs", "--save-freq", "-tb", "-P", "--device", "--num-threads", "--gym-packages", "--verbose"),
    *("-i", "--trust", "--resume"),
]
WORDS = [
    "ddpg",
    "dqn",
    "ppo2",
    fake_reach.ENV_ID,
    "NoEnv-v0",
    "gamma:0.9",
    "gamma:x",
    "policy_kwargs.n_critics:1",
    "-1",
]
arguments = st.lists(
    st.sampled_from(FLAGS) | st.sampled_from(WORDS) | st.integers().map(str) | st.text(max_size=6), max_size=6
)


@settings(max_examples=400, **SAME_EVERY_TIME, **FIXTURES_ARE_FINE)
@given(arguments)
def test_any_command_line_trains_or_says_why_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, arguments: list[str]
) -> None:
    trained = Result(tmp_path, 0, None, "SIGTEST")
    monkeypatch.setattr(training, "train", lambda *args: trained)  # whatever gets so far would really train
    monkeypatch.chdir(tmp_path)
    try:
        status = train_cli.main(["--device", "cpu", *arguments])
    except SystemExit as leaving:  # argparse
        status = int(leaving.code or 0)
    output = capsys.readouterr()
    assert status in (0, 2, 130)
    if status == 2:
        assert output.err.startswith("error: ")
        check_sentence(output.err)


ARGUMENTS = ["rho", "distance_scale", "pulse_duration", "physics_rate", "effort_limits", "damping", "target_position"]
ARGUMENTS += ["arm", "cameras", "brake", "floor", "gravity_compensation", "render_mode"]
numbers = st.floats() | st.integers() | st.floats(0.1, 2.0)
env_values = values | numbers | st.lists(numbers, min_size=3, max_size=4)


@settings(max_examples=400, **SAME_EVERY_TIME)
@given(st.dictionaries(st.sampled_from(ARGUMENTS), env_values, min_size=1, max_size=2))
def test_any_environment_options_make_a_task_or_one_sentence(options: dict[str, Any]) -> None:
    if options.get("render_mode") == "human":
        return
    try:
        env = StereoReachEnv(**options)
    except ValueError as error:
        check_sentence(str(error))
    else:
        env.close()


@pytest.fixture(scope="module")
def env() -> Any:
    env = StereoReachEnv()
    env.reset(seed=0)
    yield env
    env.close()


@settings(max_examples=400, **SAME_EVERY_TIME)
@given(action=env_values | st.lists(numbers, min_size=4, max_size=4) | st.text())
def test_any_action_is_a_step_or_one_sentence(env: StereoReachEnv, action: Any) -> None:
    before = env._distances
    try:
        image, reward, terminated, truncated, _ = env.step(action)
    except ValueError as error:
        check_sentence(str(error))
        np.testing.assert_array_equal(env._distances, before)  # nothing has moved
    else:
        assert image.shape == (1, 84, 84) and image.dtype == np.uint8
        assert -1.0 <= reward <= 1.0 and not truncated
        if terminated:
            env.reset()


poses = st.lists(st.floats(-3.2, 3.2), min_size=4, max_size=4)


@settings(max_examples=400, **SAME_EVERY_TIME)
@given(
    st.none()
    | st.dictionaries(st.sampled_from(["joint_positions", "target_position", "pose"]), poses | env_values, max_size=2)
)
def test_any_reset_options_are_an_episode_or_one_sentence(env: StereoReachEnv, options: Any) -> None:
    try:
        image, info = env.reset(options=options)
    except ValueError as error:
        check_sentence(str(error))
    else:
        assert image.shape == (1, 84, 84)
        assert np.isfinite(info["joint_positions"]).all()
    env.reset(seed=0)
    env.step(np.zeros(4))  # an error before leaves a working environment
