"""The record of picking without learning, and its table."""

from pathlib import Path

from benchmarks.analysis.picking_baselines import CASES, RECORD, read_lines, table

ROOT = Path(__file__).parents[2]


def test_the_page_has_the_table_of_the_record() -> None:
    lines = read_lines(RECORD)
    assert [(line["task"], line["policy"]) for line in lines] == [(case.task, case.policy) for case in CASES]
    assert table(lines) in (ROOT / "docs" / "pick.md").read_text(encoding="utf-8")


def test_the_scripted_policy_lifts_in_99_of_100_episodes() -> None:
    scripted = [line for line in read_lines(RECORD) if line["policy"] == "scripted"]
    assert len(scripted) == 4
    for line in scripted:
        assert int(line["n_episodes"]) == 100 and int(line["n_successes"]) >= 99


def test_a_table_of_two_lines_is_the_one_worked_out_by_hand() -> None:
    line = {"task": "lift", "policy": "random", "n_episodes": "4", "mean_steps_success": "nan", "max_steps_success": ""}
    assert table([line | {"n_successes": "0"}]).splitlines()[-1] == "| lift | random | 0 of 4 | 0 to 49 % | – |"
    found = line | {"n_successes": "2", "mean_steps_success": "3.5", "max_steps_success": "4"}
    assert table([found]).splitlines()[-1] == "| lift | random | 2 of 4 | 15 to 85 % | 3.5 (at most 4) |"
