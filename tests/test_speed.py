"""The speed script's parts: what is timed, in which order, and what the ratios mean."""

import io
import time

import pytest

from benchmarks import speed, timing

ENVS = {"ours": 10.0, "ours, with a floor": 12.0, "ours, bare": 9.0, "panda-gym": 150.0}
UPDATES = {"ddpg, ours": 10.0, "ddpg, sb3": 35.0, "dqn, ours": 4.0, "dqn, sb3": 10.0}


def test_rounds_are_interleaved_and_the_first_does_not_count() -> None:
    calls: list[str] = []

    def candidate(name: str, first: float) -> timing.Candidate:
        def call() -> float:
            calls.append(name)
            return first if calls.count(name) == 1 else float(calls.count(name))

        return call

    assert timing.medians({"a": candidate("a", 99.0), "b": candidate("b", -99.0)}, 3) == {"a": 3.0, "b": 3.0}
    assert calls == ["a", "b"] * 4


def test_a_candidate_takes_as_long_as_its_call() -> None:
    assert timing.timed(lambda: time.sleep(0.02))() >= 0.02


def test_a_worker_that_ends_is_an_error_and_not_a_hang() -> None:
    with pytest.raises(
        RuntimeError, match=r"^python -m benchmarks.updates ddpg ours no number ended before it answered$"
    ):
        timing.Worker("benchmarks.updates", "ddpg", "ours", "no number")


def test_a_worker_answers_every_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("\n\n"))
    timing.serve(lambda: 0.5)
    assert capsys.readouterr().out.split("\n") == ["ready", "took 0.5", "took 0.5", ""]


def test_the_time_inside_is_part_of_the_step() -> None:
    candidate = speed.bare()
    start = time.perf_counter()
    inside = candidate()
    assert 0 < inside < time.perf_counter() - start


def test_ratios_say_how_many_times_ours_is_faster() -> None:
    found = speed.ratios(ENVS, {"1": 100.0, "2": 180.0, "4": 300.0}, UPDATES)
    assert found == {
        "env_vs_panda_gym": 15.0,
        "env_with_floor_vs_panda_gym": 12.5,
        "env_vs_fetch": None,
        "env_scaling_2": 0.9,
        "env_scaling_4": 0.75,
        "ddpg_update_vs_sb3": 3.5,
        "dqn_update_vs_sb3": 2.5,
        "overhead_fraction": 0.1,
        "step_vs_bare": 1.11,
    }


@pytest.mark.slow
def test_the_quick_run_prints_every_ratio(capsys: pytest.CaptureFixture[str]) -> None:
    speed.main(["--quick"])
    printed = capsys.readouterr().out
    for name in ("env_scaling_2", "ddpg_update_vs_sb3", "dqn_update_vs_sb3", "overhead_fraction", "step_vs_bare"):
        assert f"| {name} | " in printed
