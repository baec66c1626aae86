"""The speed script's parts: what is timed, in which order, and what the ratios mean."""

import io
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

import benchmarks
from benchmarks.speed import __main__ as speed
from benchmarks.speed import crowded, environments, timing, trainings, updates

HERE = benchmarks.FOLDER
ENVS = {"ours": 10.0, "ours, with a floor": 12.0, "ours, bare": 9.0, "panda-gym": 150.0}
UPDATES = {"ddpg, ours": 10.0, "ddpg, sb3": 35.0, "dqn, ours": 4.0, "dqn, sb3": 10.0}
PREDICTIONS = {"ddpg, ours": 1.0, "ddpg, sb3": 0.9, "dqn, ours": 0.5, "dqn, sb3": 1.0}


def test_rounds_are_interleaved_and_the_first_does_not_count() -> None:
    calls: list[str] = []

    def candidate(name: str, first: float) -> timing.Candidate:
        def call() -> float:
            calls.append(name)
            return first if calls.count(name) == 1 else float(calls.count(name))

        return call

    assert timing.medians({"a": candidate("a", 99.0), "b": candidate("b", -99.0)}, 3) == {"a": 3.0, "b": 3.0}
    assert calls == ["a", "b"] * 4


class Clock:
    """A clock that only goes while someone works: the machine's load is no part of a test."""

    now = 100.0

    def perf_counter(self) -> float:
        return self.now

    def work(self, seconds: float) -> None:
        self.now += seconds


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(time, "perf_counter", clock.perf_counter)
    return clock


def test_a_candidate_takes_as_long_as_its_call(clock: Clock) -> None:
    assert timing.timed(lambda: clock.work(0.5))() == 0.5


def test_parts_tell_of_the_latest_call_and_with_the_rest_are_all_of_it(clock: Clock) -> None:
    parts = timing.Parts()
    carry, lift = parts.watch("carry", clock.work), parts.watch("lift", clock.work)
    seconds = iter([2.0, 1.0])

    def call() -> None:
        for _ in range(2):
            carry(next(seconds, 0.25))
        lift(4.0)
        clock.work(8.0)

    candidates = parts.candidates(call)
    first, second = ({name: candidate() for name, candidate in candidates.items()} for _ in range(2))
    assert first == {"all": 15.0, "carry": 3.0, "lift": 4.0, "the rest": 8.0}
    assert second == {"all": 12.5, "carry": 0.5, "lift": 4.0, "the rest": 8.0}


def test_a_worker_that_ends_is_an_error_and_not_a_hang() -> None:
    with (
        timing.Worker("benchmarks.speed.updates", "ddpg", "ours", "no number") as worker,
        pytest.raises(
            RuntimeError, match=r"^python -m benchmarks.speed.updates ddpg ours no number ended before it answered$"
        ),
    ):
        worker.ask("update")


def test_a_worker_answers_every_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("work\nplay\n"))
    timing.serve({"work": lambda: 0.5, "play": lambda: 2.0})
    assert capsys.readouterr().out.split("\n") == ["answer: work, play", "answer: 0.5", "answer: 2.0", ""]


def test_what_libraries_print_from_c_is_no_part_of_the_answer() -> None:
    code = """
import ctypes
from benchmarks.speed.timing import library_lines_to_stderr
with library_lines_to_stderr():
    ctypes.CDLL(None).printf(b"noise")
print("answer")
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=HERE.parent, capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("answer\n", "noise")


@pytest.mark.skipif(not Path("/proc").exists(), reason="only Linux tells")
def test_the_peak_counts_what_was_held_and_given_back() -> None:
    code = (
        "from benchmarks.speed.timing import peak_memory; before = peak_memory(); bytearray(200 * 2**20); "
        "print(peak_memory() - before)"
    )  # in a process of its own: this one may have held more before
    told = subprocess.run([sys.executable, "-c", code], cwd=HERE.parent, capture_output=True, text=True, check=True)
    assert 190 < float(told.stdout) < 260


def test_the_parts_of_an_environment_step_are_all_timed() -> None:
    taken = {name: candidate() for name, candidate in environments.step_parts().items()}
    parts = ["simulation", "efforts", "blobs", "left view", "right view", "composite"]
    assert list(taken) == ["all", *parts, "the rest"]
    assert min(taken.values()) > 0
    assert environments.bare(taken) == taken["simulation"] + taken["left view"] + taken["right view"]


def test_the_parts_of_a_training_step_are_all_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trainings, "N_STEPS", 1)
    model = trainings.make_training(n_random=5)
    n_updates = model._n_updates
    taken = {name: candidate() for name, candidate in trainings.training_parts(model).items()}
    parts = ["environment", "choosing the action", "gradient steps", "dynamics updates"]
    assert list(taken) == ["all", *parts, "the rest"]
    assert min(taken.values()) > 0
    assert model._n_updates == n_updates + 3
    assert trainings.memory(model)() > 2 * 10_000 * 84 * 84 / 2**20  # what the images alone take


def test_updates_are_medians_over_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def processes(rounds: int, threads: int) -> tuple[dict[str, float], dict[str, float]]:
        asked.append(rounds)
        return {"ddpg, ours": [5.0, 1.0, 3.0][len(asked) - 1]}, {"ddpg, ours": float(threads)}

    monkeypatch.setattr(updates, "measure_processes", processes)
    monkeypatch.setattr(updates, "N_UPDATES", 2)
    monkeypatch.setattr(updates, "N_PREDICTIONS", 10)
    monkeypatch.setattr(updates, "ROUNDS_PER_PROCESS", 4)
    assert updates.measure_updates(13, threads=1) == ({"ddpg, ours": 1500.0}, {"ddpg, ours": 100.0})
    assert asked == [4, 4, 4]
    asked.clear()
    updates.measure_updates(3, threads=1)
    assert asked == [3]


def test_ratios_say_how_many_times_ours_is_faster() -> None:
    found = speed.ratios(ENVS, {"1": 100.0, "2": 180.0, "4": 300.0}, UPDATES, PREDICTIONS)
    assert found == {
        "env_vs_panda_gym": 15.0,
        "env_with_floor_vs_panda_gym": 12.5,
        "env_vs_fetch": None,
        "env_scaling_2": 0.9,
        "env_scaling_4": 0.75,
        "ddpg_update_vs_sb3": 3.5,
        "dqn_update_vs_sb3": 2.5,
        "dqn_nature_update_vs_sbx": None,
        "ddpg_predict_vs_sb3": 0.9,
        "dqn_predict_vs_sb3": 2.0,
        "overhead_fraction": 0.1,
        "step_vs_bare": 1.11,
    }


@pytest.mark.parametrize("algo", ["ddpg", "dqn"])
def test_learners_that_are_compared_have_networks_of_one_size(algo: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """But for SB3's way of joining the action, and its missing norms after the hidden layers: a thousandth."""
    monkeypatch.setattr(updates, "N_STORED", 1)
    sizes = []
    for whose in ("ours", "sb3"):
        policy = updates.make_model(algo, whose).policy
        networks = [policy.actor, policy.critic] if algo == "ddpg" else [policy.q_net]
        sizes.append(sum(parameter.numel() for network in networks for parameter in network.parameters()))
    assert sizes[0] == pytest.approx(sizes[1], rel=0.002)


def test_the_committed_report_is_the_committed_records() -> None:
    record = json.loads((HERE / "results" / "speed.json").read_text(encoding="utf-8"))
    assert (HERE / "SPEED.md").read_text(encoding="utf-8") == speed.report(record)


@pytest.mark.parametrize("name", ["README.md", "docs/speed.md"])
def test_quoted_ratios_are_the_committed_ones(name: str) -> None:
    text = (HERE.parent / name).read_text(encoding="utf-8")
    quoted = text.split("<!-- ratios -->\n")[1].split("<!-- end of ratios -->")[0].splitlines()
    report = (HERE / "SPEED.md").read_text(encoding="utf-8").splitlines()
    assert len(quoted) > 6 and set(quoted) <= set(report)


def test_the_report_has_what_the_record_has_and_a_dash_for_a_peer_that_was_missing() -> None:
    record = {"ratios": {"env_vs_fetch": None}, "peak_memory": {"training": 512.25}, "threads": 1}
    text = speed.report({**record, "training_steps_per_second": 12.3456, "machine": "4 cores", "versions": "python 3"})
    assert text.split("\n")[4:] == [
        "| ratio | wanted | measured |",
        "| --- | --- | --- |",
        "| environment steps per second, against FetchReach | ≥ 3 | – |",
        "",
        "| peak memory of a process in MiB | |",
        "| --- | --- |",
        "| training | 512.2 |",
        "",
        "Such a training takes 12.3 environment steps per second.",
        "",
        "On 4 cores; python 3.",
        "",
    ]


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="only where the system can")
def test_environments_are_timed_on_one_core_and_what_follows_is_not() -> None:
    cores = os.sched_getaffinity(0)
    with timing.on_one_core():
        assert len(os.sched_getaffinity(0)) == 1
    assert os.sched_getaffinity(0) == cores


def test_others_are_busy_only_meanwhile() -> None:
    before = set(psutil.Process().children())
    with crowded.busy_processes(2):
        others = set(psutil.Process().children()) - before
        assert len(others) == 2
    assert not any(other.is_running() for other in others)


@pytest.mark.slow
def test_a_training_is_timed_alone_and_in_a_crowd(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(crowded, "TRAININGS", {"1 thread": "1"})
    ((name, (alone, among_others)),) = crowded.measure(rounds=1).items()
    assert name == "1 thread" and alone > 0 and among_others > 0


@pytest.mark.slow
def test_the_quick_run_prints_one_object_and_writes_nothing() -> None:
    before = (HERE / "results" / "speed.json").read_bytes(), (HERE / "SPEED.md").read_bytes()
    command = [sys.executable, "-m", "benchmarks.speed", "--quick", "--json"]
    done = subprocess.run(command, cwd=HERE.parent, stdout=subprocess.PIPE, text=True, check=True)
    printed = json.loads(done.stdout)
    for name in ("env_scaling_2", "ddpg_update_vs_sb3", "dqn_update_vs_sb3", "step_vs_bare"):
        assert printed[name] > 0
    assert printed["overhead_fraction"] < 1  # on a busy machine medians of the parts may exceed that of the whole
    assert {"env_vs_panda_gym", "env_vs_fetch"} <= printed.keys()  # null where the peer is not installed
    assert before == ((HERE / "results" / "speed.json").read_bytes(), (HERE / "SPEED.md").read_bytes())
