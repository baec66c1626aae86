"""The soak test sees what it is there for: a leak of memory, files or processes."""

import json
import subprocess
import sys

import pytest

from benchmarks.soak import Sample, Sampler, growth, main, sample


def test_growth_is_measured_from_the_first_sample() -> None:
    first = Sample(steps=10, memory=200.0, files=5, processes=1, step_time=4.0)
    last = Sample(steps=100, memory=202.0, files=6, processes=2, step_time=5.0)
    assert growth([first, Sample(50, 1.0, 1, 1, 1.0), last]) == {
        "steps": 100,
        "memory_growth": 202.0 / 200.0 - 1.0,
        "step_time_growth": 0.25,
        "more_files": 1,
        "more_processes": 1,
    }


def test_a_sample_counts_files_processes_and_memory() -> None:
    before = sample(1, 1.0, 1)
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    with open(__file__):
        after = sample(1, 1.0, 1)
    child.communicate(b"\n")
    assert after.processes == before.processes + 1
    assert after.files > before.files + 1
    assert after.memory > before.memory


def test_ten_samples_are_taken_and_shown() -> None:
    lines: list[str] = []
    sampler = Sampler(50, lines.append)
    for step in range(2, 51, 2):  # two environments
        sampler(step)
    assert [taken.steps for taken in sampler.samples] == [6, 12, 18, 24, 30, 36, 42, 48]
    assert len(lines) == 8


def test_the_command_reports_growth(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--env-steps", "20", "--learner-steps", "0", "--json"])
    result = json.loads(capsys.readouterr().out)["environment"]
    assert result["steps"] == 20 and result["more_processes"] == 0


def test_a_part_is_left_out_or_long_enough_to_be_sampled(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as status:
        main(["--learner-steps", "5"])
    assert status.value.code == 2
    assert capsys.readouterr().err.splitlines()[-1] == (
        "python -m benchmarks.soak: error: --learner-steps must be 0 or at least 20, got 5"
    )


@pytest.mark.slow
@pytest.mark.timeout(1800)  # a busy machine
def test_the_learner_neither_keeps_files_nor_processes(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--env-steps", "0", "--learner-steps", "100", "--json"])
    result = json.loads(capsys.readouterr().out)["learner"]
    assert result["more_files"] == result["more_processes"] == 0
