"""A person acts by keys: what they do is what a script of the same actions does."""

import sys
from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from sb3_stereo.commands import manual
from sb3_stereo.envs.bullet import pybullet
from sb3_stereo.envs.reach import StereoReachEnv
from sb3_stereo.sharing.minari_dataset import MinariRecorder

KEYS = {" ": {}, **{key: {ord(key): pybullet.KEY_IS_DOWN} for key in "qwersdafn"}}


@pytest.fixture
def env() -> Iterator[Any]:
    env = gym.make("WamStereoReach-v1", max_episode_steps=3)
    yield env
    env.close()


def typed(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    """Let the window have these keys, one a look, and then be closed."""
    events = iter([*(KEYS[key] for key in text), *[None] * 3])
    monkeypatch.setattr(StereoReachEnv, "keyboard_events", lambda _: next(events))


def test_keys_are_actions(env: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    typed(monkeypatch, " q  s ")
    waited: list[float] = []
    manual.play(env, seed=4, wait=waited.append)
    again = gym.make("WamStereoReach-v1")
    again.reset(seed=4)
    for action in ([1, 0, 0, 0], [0, -1, 0, 0]):
        info = again.step(np.array(action, np.float32))[-1]
    again.close()
    pixels = info["pixel_distances"].mean()
    last = f"step 2: {pixels:.1f} px of 5, {100 * info['distance']:.1f} cm"
    assert capsys.readouterr().out.splitlines()[-1] == last
    assert len(waited) == 4, "it waits where no key is down"


def test_an_episode_ends_at_its_cap_or_by_key_and_whole_ones_are_written(
    env: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("minari", reason='pip install -e ".[dataset]"')
    typed(monkeypatch, "qqqwnwww")
    written: list[Any] = []

    class Writer:
        def write(self, env: Any, episodes: Any) -> None:
            written.extend(episodes)

    manual.play(MinariRecorder(env), seed=4, writer=Writer())  # type: ignore[arg-type]
    assert [len(episode) for episode in written] == [3, 3]
    np.testing.assert_array_equal(written[0].actions, 3 * [[1, 0, 0, 0]])
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines] == [
        *("new episode", "step 1", "step 2", "step 3"),
        *("new episode", "step 1"),
        *("new episode", "step 1", "step 2", "step 3"),
        "new episode",
    ]


def test_so_many_episodes_end_it(env: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    typed(monkeypatch, "qqqqnqqqqqq")
    manual.play(env, seed=4, n_episodes=2)
    assert capsys.readouterr().out.count("step 3: ") == 2


def test_a_window_that_is_closed_during_a_step_ends_it(env: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    typed(monkeypatch, "q")

    def closed(*_: Any) -> None:
        raise pybullet.error("Not connected to physics server.")

    monkeypatch.setattr(StereoReachEnv, "step", closed)
    manual.play(env, seed=4)


def test_another_error_of_bullet_is_not_hidden(env: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    typed(monkeypatch, "qq")

    def fails(*_: Any) -> None:
        raise pybullet.error("GetBasePositionAndOrientation failed.")

    monkeypatch.setattr(StereoReachEnv, "step", fails)
    with pytest.raises(pybullet.error, match="GetBase"):
        manual.play(env, seed=4)


def test_without_a_display_it_is_one_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    assert manual.main([]) == 2
    assert capsys.readouterr().err == ("error: there is no display to open a window on; run it where there is one\n")


def test_the_help_lists_the_keys(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        manual.main(["--help"])
    printed = capsys.readouterr().out
    for line in manual.KEYS.splitlines():
        assert line in printed
