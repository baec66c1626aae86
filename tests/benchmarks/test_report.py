"""The report of the tables, from records made by hand."""

import argparse
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import benchmarks
from benchmarks.tables import cells
from benchmarks.tables.cells import Row, read, train_missing, write
from benchmarks.tables.paper import ROWS
from benchmarks.tables.report import write_report
from benchmarks.tables.row_tables import matrix
from benchmarks.tables.v1 import ROWS as V1_ROWS
from benchmarks.tables.v1 import write_v1
from sb3_stereo.evaluation.intervals import interval
from sb3_stereo.tuning import trials

ROW = Row("made_up", "ddpg", "Made up", ("-params", "gamma:0.9"), (10, 20))
SCORES = {  # (seed, step): success rate, steps, mean action, mean Q
    (0, 10): ("0.0", "nan", "1.0", "0.5"),
    (0, 20): ("1.0", "2.0", "0.5", "0.25"),
    (1, 10): ("0.5", "4.0", "0.5", "0.5"),
    (1, 20): ("1.0", "3.0", "0.5", "0.75"),
}
COLUMNS = ("success_rate", "mean_steps_success", "mean_action", "mean_q")


@pytest.fixture
def records(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(benchmarks, "RESULTS", tmp_path / "results")
    lines = [
        {"seed": str(seed), "timesteps": str(step), **dict(zip(COLUMNS, scores, strict=True)), "versions": "Python 3"}
        for (seed, step), scores in SCORES.items()
    ]
    write(ROW.record, reversed(lines))
    return tmp_path


def test_the_table_is_the_one_worked_out_by_hand(records: Path) -> None:
    text = write_report([ROW], records).read_text()
    table = """### Made up, 2 seeds

| environment steps | 10 | 20 |
| --- | --- | --- |
| success, % | 25.0 (0 to 50) | 100.0 (100 to 100) |
| episode length (successes) | 4.00 | 2.50 |
| mean \\|a\\| | 0.75 | 0.50 |
| mean Q | 0.50 | 0.50 |

`python train.py --algo ddpg --env WamStereoReach-v0 -params gamma:0.9 --seed 0 -n 20`
"""
    assert table in text
    assert text.endswith("Made with: Python 3.\n")
    assert (records / "learning_curves_ddpg.svg").stat().st_size > 1000


def test_the_same_records_give_the_same_bytes(records: Path) -> None:
    def everything() -> dict[str, bytes]:
        write_report([ROW], records)
        return {file.name: file.read_bytes() for file in records.glob("*.*")}

    assert everything() == everything()


def test_records_are_sorted_and_read_as_written(records: Path) -> None:
    assert [(int(line["seed"]), int(line["timesteps"])) for line in read(ROW.record)] == sorted(SCORES)
    np.testing.assert_array_equal(matrix(ROW, "success_rate"), [[0.0, 1.0], [0.5, 1.0]])
    assert ROW.done() == {0, 1}


def test_an_unfinished_seed_is_not_done_and_shown_only_where_it_was_scored(records: Path) -> None:
    write(ROW.record, [*read(ROW.record), {**read(ROW.record)[0], "seed": "2"}])
    assert ROW.done() == {0, 1}
    assert len(matrix(ROW, "success_rate")) == 2  # for comparisons
    text = write_report([ROW], records).read_text()
    assert "### Made up, 3 seeds, 2 to the end\n" in text
    assert "| success, % | 16.7 (0 to 50) | 100.0 (100 to 100) |" in text
    assert "| seeds | 3 | 2 |" in text


def test_a_row_that_no_seed_has_ended_is_shown_up_to_where_it_came(records: Path) -> None:
    write(ROW.record, [line for line in read(ROW.record) if line["timesteps"] == "10"])
    text = write_report([ROW], records).read_text()
    assert "### Made up, 2 seeds, none to the end\n" in text
    assert "| success, % | 25.0 (0 to 50) | – |" in text and "| seeds | 2 | 0 |" in text


def test_a_row_without_records_is_named_as_missing(records: Path) -> None:
    other = Row("other", "dqn", "Other", (), (10,))
    assert "Not measured yet: `other`." in write_report([ROW, other], records).read_text()


def test_only_missing_cells_are_trained_and_each_is_recorded(records: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(ROW.record, [{**line, "command": "python train.py"} for line in read(ROW.record)])
    trained = []

    def fit_listed(trainings: Any, folder: Path, workers: int, retries: int, on_end: Any) -> list[str]:
        for training in trainings:
            trained.append(training.options.seed)
            run = Path(training.options.log_folder)
            run.mkdir(parents=True)
            scores = [",".join(map(str, (step, *SCORES[0, step]))) for step in (10, 20)]
            (run / "evaluations.csv").write_text("\n".join([",".join(("timesteps", *COLUMNS)), *scores]))
            if training.options.seed != 3:
                on_end(training, {"run": str(run)})
        return ["disk full"]

    monkeypatch.setattr(trials, "fit_listed", fit_listed)
    monkeypatch.setattr(cells, "connected", lambda address: nullcontext())
    args = argparse.Namespace(address=None, workers=1, logs=records / "logs")
    assert train_missing([ROW], range(5), args) == ["disk full"]
    assert trained == [2, 3, 4] and ROW.done() == {0, 1, 2, 4}
    assert train_missing([ROW], range(3), args) == [] and len(trained) == 3, "nothing is missing"


def test_interval_of_equal_seeds_is_their_value_and_of_others_lies_around_the_mean() -> None:
    assert interval(np.full(5, 7.0)) == (7.0, 7.0)
    low, high = interval(np.array([1.0, 2.0, 3.0, 4.0, 5.0]))
    assert 1.0 < low < 3.0 < high < 5.0


def test_the_claim_is_judged_by_its_interval(records: Path) -> None:
    rows = [Row(name, name.split("_")[1], name, (), (10, 20)) for name in ("ours_ddpg", "ours_dqn")]
    lines = [{**line, "mean_steps_capped": "3.0"} for line in read(ROW.record)]
    write(rows[0].record, lines)
    worse = {"success_rate": "0.0", "mean_steps_capped": "30.0"}
    write(rows[1].record, [{**line, **worse, "success_rate": str(0.1 * int(line["seed"]))} for line in lines])
    text = write_report(rows, records).read_text()
    assert "| ours_ddpg | ours_dqn | 2 and 2 | success, points | 95.0 (90.0 to 100.0) | confirmed |" in text
    assert "| 2 and 2 | episode length, failures as 30 | -27.0 (-27.0 to -27.0) | confirmed |" in text
    write(rows[0].record, [{**line, **worse} for line in lines])
    write(rows[1].record, lines)
    text = write_report(rows, records).read_text()
    assert text.count("| refuted |") == 2 and "| 27.0 (27.0 to 27.0) | refuted |" in text
    write(rows[0].record, lines)
    assert write_report(rows, records).read_text().count("| 0.0 (0.0 to 0.0) | undecided |") == 2
    assert "Is DDPG better" not in write_report(rows[:1], records).read_text()


def test_the_best_possible_stands_above_the_tables(records: Path) -> None:
    (records / "results" / "optimum.csv").write_text("pose,steps\n1,3\n0,1\n2,1\n")
    text = write_report([ROW], records).read_text()
    assert "with 1.67 steps on average (2 in 1, 0 in 2, 1 in 3; a search" in text


def test_the_report_of_version_1_is_that_of_the_committed_records_and_quoted_in_the_readme(tmp_path: Path) -> None:
    root = Path(__file__).parents[2]
    report = write_v1(tmp_path).read_text()
    assert report == (root / "benchmarks" / "V1.md").read_text()
    quoted = (root / "README.md").read_text().split("<!-- v1 -->\n")[1].split("<!-- end of v1 -->")[0]
    assert quoted.count("|") > 20 and quoted in report


def test_the_rows_of_version_1_can_be_trained() -> None:
    for row in V1_ROWS:
        config = row.config()
        assert config.env_id.endswith("-v1") and config.n_timesteps == row.checkpoints[-1]


def test_the_readme_quotes_the_committed_report() -> None:
    root = Path(__file__).parents[2]
    quoted = (root / "README.md").read_text().split("<!-- results -->\n")[1].split("<!-- end of results -->")[0]
    assert quoted.count("|") > 20 and quoted in (root / "benchmarks" / "RESULTS.md").read_text()


def test_the_committed_report_is_that_of_the_committed_records(tmp_path: Path) -> None:
    committed = Path(__file__).parents[2] / "benchmarks"
    assert write_report(ROWS, tmp_path).read_bytes() == (committed / "RESULTS.md").read_bytes()
