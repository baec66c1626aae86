"""Films: the step stays the same, the picture shows what is there, the file can be played."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import fake_reach
import gymnasium as gym
import numpy as np
import pytest
from tiny_training import QUICK, TINY

from sb3_stereo.commands import enjoy
from sb3_stereo.commands import train as train_cli
from sb3_stereo.envs.markers import Blobs, find_blobs
from sb3_stereo.envs.reach import StereoReachEnv
from sb3_stereo.envs.wrappers import QuantizedActions, WatchedPulses
from sb3_stereo.errors import ConfigError
from sb3_stereo.viz.drawing import GREEN, RED, Caption, Effort, View, annotated, capture, scene
from sb3_stereo.viz.film import END, N_PARTS, OVERVIEW, PAUSE, Filmed, make_writer

ACTIONS = np.random.default_rng(0).uniform(-1, 1, (3, 4)).astype(np.float32)


@pytest.fixture
def env() -> Iterator[Any]:
    made = gym.make("WamStereoReach-v0")
    yield made
    made.close()


class Pictures:
    """A writer that remembers."""

    def __init__(self) -> None:
        self.pictures: list[Any] = []
        self.times: list[int] = []

    def write(self, picture: Any, n: int) -> None:
        self.pictures.append(picture)
        self.times.append(n)

    def close(self) -> None:
        pass


def rollout(env: Any) -> list[Any]:
    steps = [env.reset(seed=3)]
    steps += [env.step(action) for action in ACTIONS]
    return steps


def test_watching_a_pulse_changes_neither_motion_nor_reward(env: Any) -> None:
    plain, looks = rollout(env), []
    watched = WatchedPulses(env, lambda efforts: looks.append((efforts, env.unwrapped.draw())), 5)
    for expected, found in zip(plain, rollout(watched)):
        np.testing.assert_array_equal(found[0], expected[0])
        assert found[1:-1] == expected[1:-1]
        np.testing.assert_equal(found[-1], expected[-1])
    assert len(looks) == 4 * len(ACTIONS)
    np.testing.assert_allclose(looks[0][0], ACTIONS[0] * env.unwrapped.effort_limits)
    first, second = (find_blobs(frames[0]).end_effector for _, frames in looks[:2])
    assert np.hypot(*(second - first)) > 0.5  # the arm is on its way


def test_watchers_of_one_pulse_look_at_their_own_parts_of_it(env: Any) -> None:
    plain, arm = rollout(env), env.unwrapped.arm
    looks: dict[str, list[Any]] = {"twice": [], "again": [], "thrice": []}
    watched = env
    for name, n_parts in (("twice", 2), ("again", 2), ("thrice", 3)):
        watched = WatchedPulses(
            watched, lambda _, name=name: looks[name].append(arm.actuated_positions.tolist()), n_parts
        )
    for expected, found in zip(plain, rollout(watched)):
        np.testing.assert_array_equal(found[0], expected[0])
        assert found[1:-1] == expected[1:-1]
    assert [len(each) for each in looks.values()] == [3, 3, 6]
    assert looks["twice"] == looks["again"]
    assert not any(half in looks["thrice"] for half in looks["twice"])
    rollout(env)  # not through the wrappers
    assert [len(each) for each in looks.values()] == [3, 3, 6]


def test_a_film_in_a_window_is_as_long_as_any_other(env: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    pauses: list[float] = []
    monkeypatch.setattr(enjoy.time, "sleep", pauses.append)
    writer = Pictures()
    monkeypatch.setattr("sb3_stereo.viz.film.make_writer", lambda *_: writer)
    with enjoy.watched(env, window=True, video=Path("film.mp4"), zoom=1.0) as both:
        rollout(both)
    pulse = [1] * (N_PARTS - 1) + [PAUSE]
    assert writer.times == [PAUSE, *pulse * len(ACTIONS)]
    assert len(pauses) == (N_PARTS - 1) * len(ACTIONS)


def test_a_film_holds_the_parts_of_each_pulse_and_pauses_at_its_result(env: Any) -> None:
    writer = Pictures()
    rollout(Filmed(env, writer))
    pulse = [1] * (N_PARTS - 1) + [PAUSE]
    assert writer.times == [PAUSE, *pulse * len(ACTIONS)]
    assert len({picture.shape for picture in writer.pictures}) == 1
    assert not np.array_equal(writer.pictures[1], writer.pictures[2])


def test_the_end_of_an_episode_is_said_in_green_or_red() -> None:
    def coloured(picture: Any, colour: tuple[int, ...]) -> int:
        return int((picture[-100:] == colour).all(axis=2).sum())

    env = gym.make("WamStereoReach-v0", rho=390.0, max_episode_steps=1)
    writer = Pictures()
    film = Filmed(env, writer)
    for rho in (500.0, 1e-9):
        film.unwrapped.rho = 1e-9  # no start is a goal
        film.reset(seed=1)
        film.unwrapped.rho = rho
        film.step(np.zeros(4, np.float32))
    env.close()
    reached, failed = (writer.pictures[i] for i, n in enumerate(writer.times) if n == END)
    assert coloured(reached, GREEN) > 200 and coloured(reached, RED) == 0
    assert coloured(failed, RED) > 200 and coloured(failed, GREEN) == 0


def test_a_discrete_agents_film_shows_its_efforts() -> None:
    env = QuantizedActions(gym.make("WamStereoReach-v0"))
    film = Filmed(env, Pictures())
    film.reset(seed=0)
    film.step(np.int64(env.number_of(np.array([2, 0, 1, 2]))))
    env.close()
    assert [(e.joint, e.torque, e.share) for e in film.efforts] == [
        ("J1", 20, 1),
        ("J2", -30, -1),
        ("J3", 0, 0),
        ("J4", 5, 1),
    ]


@pytest.mark.parametrize("kwargs", [{}, {"floor": True}, {"randomize": {"floor": 1.0, "shadow": 0.4}}])
def test_a_picture_of_the_whole_scene_leaves_it_as_it_is(kwargs: dict[str, Any]) -> None:
    env, other = (StereoReachEnv(**kwargs) for _ in range(2))
    env.reset(seed=1)
    other.reset(seed=1)
    size = {"width": 200, "height": 150}
    picture = env.draw_from(replace(OVERVIEW, **size))
    assert picture.shape == (150, 200, 3)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 20  # floor, shadow, arm and markers
    for action in ACTIONS:
        np.testing.assert_array_equal(env.step(action)[0], other.step(action)[0])
        env.draw_from(replace(OVERVIEW, **size))
        for height in (120, 300):
            assert all(frame.shape[:2] == (height, height * 4 // 3) for frame in env.draw_larger(height))
    env.close()
    other.close()


def test_a_film_measures_the_markers_as_the_reward_does() -> None:
    env = StereoReachEnv(framing="close", markers="hollow")
    _, info = env.reset(seed=2)
    for height in (None, 300):
        offsets = [view.blobs.offset for view in capture(env, height)]
        np.testing.assert_allclose(offsets, info["pixel_offsets"])
    env.close()


def test_rings_are_around_the_markers_of_a_larger_picture_too() -> None:
    env = StereoReachEnv(framing="close", markers="hollow")
    env.reset(seed=2)
    small, large = (annotated(capture(env, height)[0], shown_height=480) for height in (240, 480))
    rings = [np.argwhere((picture == (190, 0, 0)).all(axis=2)).mean(axis=0) for picture in (small, large)]
    np.testing.assert_allclose(*rings, atol=1.0)
    env.close()


@pytest.mark.parametrize("zoom", [1.0, 1.6])
def test_rings_are_around_the_markers_wherever_the_view_is_zoomed(zoom: float) -> None:
    frame = np.full((240, 320, 3), 255, np.uint8)
    cv2.circle(frame, (130, 100), 3, (255, 0, 0), cv2.FILLED)
    cv2.circle(frame, (200, 160), 3, (0, 0, 255), cv2.FILLED)
    blobs = find_blobs(frame)
    picture = annotated(View("left", frame, blobs), zoom)
    assert picture.shape == (360, 480, 3)
    pure = np.argwhere((picture == (190, 0, 0)).all(axis=2))  # of the ring
    expected = (blobs.end_effector - (159.5, 119.5)) * 1.5 * zoom + (239.5, 179.5)
    np.testing.assert_allclose(pure.mean(axis=0)[::-1], expected, atol=1.0)


def test_the_distance_is_whole_wherever_the_markers_are() -> None:
    frame = np.full((240, 320, 3), 255, np.uint8)
    inks = []
    for x, y in ((160, 120), (160, 12), (4, 120), (316, 12), (316, 236)):
        blobs = Blobs(np.array([x, y], float), np.array([x, y - 1.0]))
        picture = annotated(View("left", frame, blobs))
        grey = (picture.max(axis=2) - picture.min(axis=2) < 30) & (picture.max(axis=2) < 200)
        inks.append(int(grey.sum()))
    assert max(inks) - min(inks) < 0.1 * max(inks), inks


def test_a_hidden_marker_gets_no_ring_and_no_distance() -> None:
    hidden = Blobs(np.full(2, np.nan), np.full(2, np.nan))
    picture = annotated(View("left", np.full((240, 320, 4), 255, np.uint8), hidden))
    assert (picture == 255).all()


@pytest.mark.parametrize("n_views", [1, 2, 3])
def test_a_scene_fits_any_number_of_views(n_views: int) -> None:
    frame = np.full((240, 320, 3), 255, np.uint8)
    view = View("a", frame, Blobs(np.array([10.0, 20.0]), np.array([300.0, 200.0])))
    caption = Caption(["step 1"], [Effort("J1", 3.0, 0.5)], "reached")
    height, width, _ = scene([view] * n_views, np.zeros((1, 42 * n_views, 84), np.uint8), caption).shape
    assert height % 2 == width % 2 == 0 and width >= 480 * n_views


def test_a_joint_s_name_ends_before_its_bar() -> None:
    """Whatever its length: long names begin further to the left."""

    def drawn(joint: str) -> np.ndarray:
        view = View("a", np.full((240, 320, 3), 255, np.uint8), Blobs(np.full(2, np.nan), np.full(2, np.nan)))
        return scene([view], np.zeros((1, 42, 84), np.uint8), Caption([], [Effort(joint, 0.0, 0.0)], ""))

    nameless, short, long = drawn(""), drawn("J1"), drawn("panda_joint1")
    ends = [np.flatnonzero((nameless != named).any(axis=(0, 2))).max() for named in (short, long)]
    assert abs(ends[0] - ends[1]) <= 3


@pytest.fixture(scope="module")
def wam_logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tiny run on the real environment, with two checkpoints."""
    logs = tmp_path_factory.mktemp("logs")
    flags = ["-n", "30", "--save-freq", "15", "--eval-freq", "-1", "--n-eval-envs", "1", "--num-threads", "1"]
    flags += ["--env-kwargs", "max_episode_steps:2", "-params", *TINY, "callback:null"]
    assert train_cli.main(["--algo", "ddpg", "--seed", "1", "-f", str(logs), *flags]) == 0
    return logs


def play(wam_logs: Path, *arguments: str) -> int:
    return enjoy.main(["-f", str(wam_logs), "--num-threads", "1", "--device", "cpu", *arguments])


@pytest.mark.parametrize("suffix", [".gif", ".mp4"])
def test_enjoy_films_whole_episodes_that_can_be_played(
    suffix: str, wam_logs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / f"film{suffix}"
    which = ["--load-checkpoint", "15"] if suffix == ".mp4" else ["--load-last-checkpoint"]
    flags = [*which, "--exp-id", "1", "--n-episodes", "1"]
    assert play(wam_logs, *flags, "--video", str(file)) == 0
    output = capsys.readouterr().out
    assert (
        f"rl_model_{15 if suffix == '.mp4' else 30}_steps.zip" in output
        and f"Filmed into {file}" in output
        and "1 episodes" in output
    )
    film = cv2.VideoCapture(str(file))
    if suffix == ".mp4":
        assert int(film.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little") == b"h264"
    frames = [film.read()[1] for _ in range(2 * N_PARTS)]  # a GIF's pictures stand longer instead of coming again
    assert frames[0].shape[1] > 700
    assert not np.array_equal(frames[0], frames[-1])


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--video", "film.avi"], "cannot write the video 'film.avi'; the name must end in .gif, .mp4"),
        (["--video", "."], "cannot write the video '.'; the name must end in .gif, .mp4"),
        (
            ["--video", "nowhere/film.gif"],
            "cannot write 'nowhere/film.gif' (no folder 'nowhere'); choose another with --video",
        ),
    ],
)
def test_what_cannot_be_filmed_is_one_sentence(
    flags: list[str], message: str, wam_logs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert play(wam_logs, *flags) == 2
    assert capsys.readouterr().err == f"error: {message}\n"


@pytest.mark.parametrize("suffix", [".gif", ".mp4"])
def test_a_place_where_nothing_can_be_written_is_one_sentence(suffix: str) -> None:
    with pytest.raises(ConfigError, match=rf"^cannot write '/proc/film{suffix}' \(No such file or directory\); "):
        make_writer(Path(f"/proc/film{suffix}"), 12.0)


def test_a_folder_is_no_video(tmp_path: Path) -> None:
    folder = tmp_path / "film.mp4"
    folder.mkdir()
    with pytest.raises(ConfigError) as error:
        make_writer(folder, 12.0)
    assert str(error.value) == f"cannot write the video '{folder}', which is a folder; choose another name with --video"


def test_an_environment_without_cameras_says_so(logs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    env = ["--env", fake_reach.ENV_ID, *QUICK, "-f", str(logs)]
    assert train_cli.main([*env, "-n", "12", "--n-eval-envs", "1", "-params", *TINY]) == 0
    assert enjoy.main([*env, "--video", "film.gif"]) == 2
    assert capsys.readouterr().err.endswith(
        "error: FakeReach-v0 cannot be watched, only environments of sb3_stereo can; add --no-render\n"
    )
