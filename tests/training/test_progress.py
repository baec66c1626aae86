"""Progress: lines in a log, a bar where one is asked for, both with the time left; tables that people read."""

import time

import fake_reach
import pytest

from sb3_stereo.commands.train import settings_table
from sb3_stereo.config.schema import load_config, settings
from sb3_stereo.console import Bar, duration, phase, print_line
from sb3_stereo.evaluation import scores


class Clock:
    """A clock that only goes when told."""

    now = 100.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(time, "monotonic", clock.monotonic)
    return clock


def test_a_log_gets_a_line_now_and_then_with_the_time_left(clock: Clock, capsys: pytest.CaptureFixture[str]) -> None:
    bar = Bar(100, "step", bar=False, interval=30.0)
    for seconds, done in ((10, 10), (40, 20), (50, 22), (80, 40)):
        clock.now = 100.0 + seconds
        bar.update(done, "success 5 %")
    bar.close()
    assert capsys.readouterr().err.splitlines() == [
        "20/100 steps, success 5 %, 0.5 steps/s, 3 min left",
        "40/100 steps, success 5 %, 0.5 steps/s, 2 min left",
    ]


def test_a_phase_has_lines_of_its_own_with_its_name(clock: Clock, capsys: pytest.CaptureFixture[str]) -> None:
    bar = Bar(100, "step", bar=False, interval=30.0)
    with phase("evaluation", 50, "pose") as update:
        for seconds, done in ((20, 10), (40, 20)):
            clock.now = 100.0 + seconds
            update(done)
    bar.close()
    assert capsys.readouterr().err == "evaluation: 20/50 poses, 0.5 poses/s, 60 s left\n"


def test_a_phase_without_a_bar_is_silent(clock: Clock, capsys: pytest.CaptureFixture[str]) -> None:
    Bar(100, "step", bar=False).close()
    with phase("evaluation", 50, "pose") as update:
        clock.now += 100
        update(20)
    assert capsys.readouterr().err == ""


def test_a_phase_is_a_second_bar_while_it_lasts(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rich")
    bar = Bar(4, "step", bar=True)
    bar.update(1)
    with phase("evaluation", 7, "pose") as update:
        update(5)
        assert bar.progress is not None
        assert [task.total for task in bar.progress.tasks] == [4, 7]
    assert [task.total for task in bar.progress.tasks] == [4]
    bar.close()
    assert "evaluation" in capsys.readouterr().err


def test_what_was_done_before_does_not_count_for_the_speed(clock: Clock) -> None:
    bar = Bar(100, "step", bar=False, done=50)
    assert bar.left(50) == "time left unknown"
    clock.now += 10
    assert bar.left(60) == "40 s left"


def test_a_bar_shows_the_count_and_lines_stay_whole(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rich")
    bar = Bar(4, "pose", bar=True)
    bar.update(3, "fine")
    print_line("a line")
    bar.update(4)
    bar.close()
    bar.close()
    output = capsys.readouterr()
    assert output.out == "a line\n" and "4/4" in output.err and "pose" in output.err


def test_durations_are_said_in_the_unit_that_fits() -> None:
    assert [duration(s) for s in (0.4, 119, 600, 9000)] == ["0 s", "119 s", "10 min", "2.5 h"]


def test_the_settings_name_every_number_and_call_classes_by_their_name() -> None:
    config = load_config("dqn", fake_reach.ENV_ID, params={"gamma": 0.25})
    found = settings(config)
    assert found["algo"] == "dqn" and found["gamma"] == 0.25
    assert found["QuantizedActions"] == "(levels=3)"
    lines = settings_table(config).splitlines()
    assert len(lines) == len(found) and len({line.index(line.split()[1]) for line in lines[:3]}) == 1


def test_the_scores_are_one_line_each() -> None:
    score = {
        "success_rate": 0.5,
        "mean_steps_success": 2.0,
        "mean_return": 1.0,
        "mean_action": 0.25,
        "mean_q": 0.75,
        "seconds": 30.0,
    }
    unreached = score | {"success_rate": 0.0, "mean_steps_success": float("nan")}
    assert scores.score_table({1500: unreached, 2000: score}).splitlines() == [
        "  steps  success  episode length  return   |a|     Q  after",
        "   1500      0 %               –    1.00  0.25  0.75   30 s",
        "   2000     50 %            2.00    1.00  0.25  0.75   30 s",
    ]
