"""Whatever comes in, the answer is a documented error in one sentence, or it works: never a traceback, a hang or a NaN.

The cases are drawn by Hypothesis, always the same ones; together they are more than three thousand.
"""

import re
from collections.abc import Iterator
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import fake_reach
import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sb3_stereo.commands import train as train_cli
from sb3_stereo.config.schema import Config, load_config, parse_config
from sb3_stereo.envs.arm import Arm
from sb3_stereo.envs.bullet_camera import Camera
from sb3_stereo.envs.cameras import STEREO_PAIR, CameraSpec, camera_specs
from sb3_stereo.envs.reach import StereoReachEnv
from sb3_stereo.envs.robots import WAM, ArmSpec, arm_spec
from sb3_stereo.envs.simulation import Client
from sb3_stereo.envs.specs import plain
from sb3_stereo.errors import ConfigError
from sb3_stereo.training import Result
from sb3_stereo.training import trainer as training

ROOT = Path(__file__).parents[2]
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
    try:
        env = StereoReachEnv(**options)
    except ValueError as error:
        check_sentence(str(error))
        return
    check_episode(env)


def check_episode(env: StereoReachEnv) -> None:
    """An environment that has been made begins, or says why it cannot, and moves without a NaN."""
    try:
        env.reset(seed=0)
    except ValueError as error:
        check_sentence(str(error))
    else:
        image, reward, *_, info = env.step(np.ones(env.action_space.shape))
        assert image.shape == env.observation_space.shape and -1.0 <= reward <= 1.0
        assert np.isfinite(info["joint_positions"]).all() and np.isfinite(info["end_effector_position"]).all()
    finally:
        env.close()


def some_changes(spec: Any) -> st.SearchStrategy[dict[str, Any]]:
    """One or two fields of a dataclass, with anything in them."""
    anything = env_values | st.lists(st.text(max_size=3) | numbers, max_size=4) | st.sampled_from(plain(WAM)["joints"])
    return st.dictionaries(st.sampled_from(list(plain(spec))), anything, min_size=1, max_size=2)


@pytest.fixture(scope="module")
def client() -> Iterator[Client]:
    client = Client()
    yield client
    client.close()


@settings(max_examples=400, **SAME_EVERY_TIME)
@given(changes=some_changes(STEREO_PAIR[0]), as_map=st.booleans())
def test_any_camera_draws_or_is_one_sentence(client: Client, changes: dict[str, Any], as_map: bool) -> None:
    try:
        if as_map:
            (spec,) = camera_specs([plain(STEREO_PAIR[0]) | changes])
        else:
            spec = replace(STEREO_PAIR[0], **changes)
    except ValueError as error:
        check_sentence(str(error))
        return
    assert isinstance(spec, CameraSpec)
    if spec.width * spec.height < 500_000:
        assert Camera(spec, client).frame().shape == (spec.height, spec.width, 4)


@settings(max_examples=400, **SAME_EVERY_TIME)
@given(changes=some_changes(WAM), as_map=st.booleans())
def test_any_arm_moves_or_is_one_sentence(changes: dict[str, Any], as_map: bool) -> None:
    try:
        spec = arm_spec(plain(WAM) | changes) if as_map else replace(WAM, **changes)
        env = StereoReachEnv(arm=spec)
    except ValueError as error:
        check_sentence(str(error))
        return
    assert isinstance(spec, ArmSpec)
    check_episode(env)


URDF = (files("sb3_stereo.envs") / "assets" / "wam.urdf").read_text(encoding="utf-8")
NUMBERS = [match.span() for match in re.finditer(r"-?\d+\.\d+", URDF)]
TAGS = [match.span() for match in re.finditer(r"<[^>]+>", URDF)]
WRONG_NUMBERS = ["nan", "inf", "-inf", "1e300", "-1e300", "1e-300", "0", "-1", "", "x", "1 2"]


def replaced(span: tuple[int, int], text: str) -> str:
    return URDF[: span[0]] + text + URDF[span[1] :]


urdfs = (
    st.binary(max_size=60)
    | st.builds(replaced, st.sampled_from(NUMBERS), st.sampled_from(WRONG_NUMBERS)).map(str.encode)
    | st.builds(replaced, st.sampled_from(TAGS), st.sampled_from(["", "<robot>", "<link/>", "</joint>"])).map(
        str.encode
    )
    | st.integers(0, len(URDF)).map(lambda end: URDF[:end].encode())
)


@settings(max_examples=80, **SAME_EVERY_TIME, **FIXTURES_ARE_FINE)
@given(content=urdfs)
def test_any_robot_file_moves_or_is_one_sentence(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "any.urdf"
    file.write_bytes(content)
    client = Client()
    try:
        arm = Arm(replace(WAM, urdf=str(file)), client)
    except ValueError as error:
        check_sentence(str(error))
    else:
        arm.rest_at(arm.limits.mean(axis=1))
        arm.push(list(WAM.effort_limits), 20)
        assert np.isfinite(arm.joint_positions).all() and np.isfinite(arm.end_effector_position).all()
    finally:
        client.close()


@settings(max_examples=200, **SAME_EVERY_TIME)
@given(
    path=st.text(max_size=300) | st.sampled_from(["", ".", "/", "wam.yml", "a" * 5000, "a" * 5000 + ".yml", "\0.yml"])
)
def test_any_path_is_no_robot_in_one_sentence(client: Client, path: str) -> None:
    for load in (lambda: arm_spec(path), lambda: Arm(replace(WAM, urdf=path), client)):
        with pytest.raises(ValueError) as error:
            load()
        check_sentence(str(error.value))


@pytest.fixture(scope="module")
def env() -> Any:
    env = StereoReachEnv()
    env.reset(seed=0)
    yield env
    env.close()


@settings(max_examples=400, **SAME_EVERY_TIME)
@given(action=env_values | st.lists(numbers, min_size=4, max_size=4) | st.text())
def test_any_action_is_a_step_or_one_sentence(env: StereoReachEnv, action: Any) -> None:
    before = env._captured.distances
    try:
        image, reward, terminated, truncated, _ = env.step(action)
    except ValueError as error:
        check_sentence(str(error))
        np.testing.assert_array_equal(env._captured.distances, before)  # nothing has moved
    else:
        assert image.shape == (1, 84, 84) and image.dtype == np.uint8
        assert -1.0 <= reward <= 1.0 and not truncated
        if terminated:
            env.reset()


poses = st.lists(st.floats(-3.2, 3.2), min_size=4, max_size=4)


@settings(max_examples=250, **SAME_EVERY_TIME)
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
