"""The report's sections on readings and baselines, from records made by hand."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import benchmarks
from benchmarks.analysis.baselines import STRICT, goal_record, task_of, write_lines
from benchmarks.analysis.looks import looks_record
from benchmarks.tables.cells import read, write
from benchmarks.tables.paper import ROWS
from benchmarks.tables.reading_tables import match
from benchmarks.tables.readings import READING_ROWS, READINGS
from benchmarks.tables.report import write_report
from benchmarks.tables.row_tables import PUBLISHED

DDPG = READINGS[0].rows[0]
SAME_SETTINGS = (
    "paper_ddpg_channel_gamma_0.99",
    *(f"paper_dqn_gamma_{gamma}" for gamma in (0.2, 0.5, 0.9)),
    "ours_ddpg",
)


@pytest.fixture
def records(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(benchmarks, "RESULTS", tmp_path / "results")
    baseline = {"success_rate": "0.5", "mean_steps_success": "2", "mean_steps_capped": "16", "n_poses": "100"}
    for task in (STRICT, READINGS[0].task):
        write_lines(task.record, [{"kind": "random", "baseline": f"random in {task.name}", **baseline}])
    return tmp_path


def record(success: dict[int, tuple[float, ...]]) -> None:
    """Record the success of DDPG's first checkpoints, by seed."""
    scores = {"mean_steps_success": "2.0", "mean_action": "0.9", "mean_q": "1.0", "versions": "v"}
    lines = [
        {"seed": str(seed), "timesteps": str(step), "success_rate": str(rate), **scores}
        for seed, rates in success.items()
        for step, rate in zip(DDPG.checkpoints, rates)
    ]
    write(DDPG.record, lines)


def test_every_reading_learns_its_own_task_with_the_papers_settings() -> None:
    for reading in READINGS:
        assert {task_of(row.config()) for row in reading.rows} == {reading.task}
        for row, name in zip(reading.rows, SAME_SETTINGS, strict=True):
            default = next(other for other in ROWS if other.name == name)
            assert replace(row.config(), env_kwargs={}) == replace(default.config(), env_kwargs={})
    assert set(READING_ROWS) <= set(ROWS) and len({row.name for row in ROWS}) == len(ROWS)
    assert all(len(part) == len(row.checkpoints) for row in ROWS for part in PUBLISHED.get(row.name, ()))


def test_a_reading_has_a_section_with_its_cells_beside_the_published_ones(records: Path) -> None:
    record({0: (1.0, 0.96), 1: (1.0,)})
    text = write_report(ROWS, records).read_text()
    assert (records / "readings.svg").stat().st_size > 1000
    default, readings = text.split("## Other readings of the paper\n")
    assert DDPG.label + ", 2 seeds" not in default
    assert f"### Reading: {READINGS[0].title}\n" in readings and READINGS[1].title not in readings
    assert f"| {DDPG.label} | 1500 | 100 % | 100.0 (100 to 100) | 1.95 | 2.00 | yes |" in readings
    assert f"| {DDPG.label} | 2000 | 100 % | 96.0 | 2.92 | 2.00 | one seed |" in readings
    assert f"| {DDPG.label} | 5000 |" not in readings
    assert f"#### {DDPG.label}, 2 seeds, none to the end\n" in readings


@pytest.mark.parametrize(
    ("published", "success", "verdict"),
    [
        (100, [], ""),
        (100, [100.0], "equal, one seed"),
        (31, [92.0], "one seed"),
        (100, [100.0, 100.0, 100.0], "yes"),
        (100, [90.0, 95.0, 99.0], "no"),
        (31, [10.0, 40.0, 50.0], "yes"),
    ],
)
def test_a_cell_is_matched_if_its_interval_holds_what_is_published(
    published: float, success: list[float], verdict: str
) -> None:
    assert match(published, np.array(success)) == verdict


def test_every_table_says_what_is_reached_without_learning(records: Path) -> None:
    record({0: (1.0, 0.96)})
    write(ROWS[0].record, [{**line, "timesteps": str(ROWS[0].checkpoints[0])} for line in read(DDPG.record)[:1]])
    text = write_report(ROWS, records).read_text()
    assert "| fixed target, the default | random in strict | 50 | 2.00 | 16.00 |" in text
    for name in ("strict", "observation"):
        assert text.count(f"Without learning: random in {name} 50 % in 2.00 steps.\n") == 1


def test_goals_in_space_and_looks_are_shown_as_recorded(records: Path) -> None:
    record({0: (1.0,)})
    goals = {"median_cm": "14.1", "quantile_95_cm": "20", "within_5_cm": "0.052", "n_goals": "9"}
    write_lines(goal_record(), [{"task": "strict", **goals}, {"task": "of another version", **goals}])
    scores = {"success_rate": "1", "shuffled_success_rate": "0.99", "mean_steps_capped": "1.6"}
    scores |= {"shuffled_mean_steps_capped": "1.9", "action_spread": "0.054"}
    write_lines(looks_record(), [{"row": DDPG.name, "seed": "0", "timesteps": "1500", **scores}])
    text = write_report(ROWS, records).read_text()
    assert "| fixed target, the default | 14.1 | 20.0 | 5.2 |" in text and "another version" not in text
    assert f"| {DDPG.label}; {READINGS[0].title} | 0 | 1500 | 100 | 99 | 1.60 | 1.90 | 0.05 |" in text
