"""The page on disturbed worlds is made from the record alone."""

from dataclasses import asdict, replace
from pathlib import Path

import pytest

import benchmarks
from benchmarks.analysis import disturbances
from sb3_stereo.evaluation.disturbances import CLEAN, Score

ROOT = Path(__file__).parents[2]
NAN = float("nan")
SCORES = [
    Score(CLEAN, "", "", NAN, "", 1.0, 3.5, 0.9, 40),
    Score("noise", "sensor", "mild", 5.0, "of 255", 1.0, 3.6, 0.9, 40),
    Score("noise", "sensor", "middle", 15.0, "of 255", 0.5, 16.0, 0.4, 40),
    Score("noise", "sensor", "hard", 40.0, "of 255", 0.0, 30.0, 0.0, 40),
    Score("no brake", "arm", "hard", 1.0, "", 0.25, 25.0, 0.1, 40),
]


@pytest.fixture
def results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(benchmarks, "RESULTS", tmp_path / "results")
    (tmp_path / "results").mkdir()
    return tmp_path


def lines(row: str, seed: int, factor: float) -> list[dict[str, str]]:
    agent = {"row": row, "seed": str(seed), "timesteps": "8500"}
    scores = [replace(score, success_rate=factor * score.success_rate) for score in SCORES]
    return [agent | {key: disturbances._text(value) for key, value in asdict(score).items()} for score in scores]


def test_the_page_has_a_column_per_agent_with_means_over_its_seeds(results: Path) -> None:
    for seed, factor in ((0, 1.0), (1, 0.5)):
        disturbances.add_lines(lines("v1_robust_ddpg", seed, factor))
    disturbances.add_lines(lines("v1_ours_ddpg", 0, 0.4))
    disturbances.write_page()
    table = [line for line in (results / "ROBUSTNESS.md").read_text().splitlines() if line.startswith("|")]
    assert table == [
        "| change | sizes | ours, clean images (1 seed) | ours, augmented images (2 seeds) |",
        "| --- | --- | --- | --- |",
        "| undisturbed |  | 40 | 75 |",
        "| noise | 5 / 15 / 40 of 255 | 40 / 20 / 0 | 75 / 38 / 0 |",
        "| no brake | 1 | 10 | 19 |",
        "| **mean, mild** |  | 40 | 75 |",
        "| **mean, middle** |  | 20 | 38 |",
        "| **mean, hard** |  | 5 | 9 |",
        "| **mean of all** |  | 18 | 33 |",
    ]
    assert (results / "robustness.png").stat().st_size > 10_000


def test_a_second_scoring_takes_the_place_of_the_first(results: Path) -> None:
    disturbances.add_lines(lines("v1_ours_ddpg", 0, 0.4))
    disturbances.add_lines(lines("v1_ours_ddpg", 0, 1.0))
    ((seed,),) = disturbances.agents().values()
    assert seed[1:] == SCORES[1:]


def test_a_run_needs_a_name_of_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert disturbances.main(["somewhere", "--name", "mine"]) == 2
    assert capsys.readouterr().err == (
        "error: unknown name 'mine'; the table's agents are v1_ours_ddpg, v1_robust_ddpg, v1_ours_dqn\n"
    )


def test_the_committed_page_is_that_of_the_committed_record() -> None:
    assert (ROOT / "benchmarks" / "ROBUSTNESS.md").read_text() == disturbances.page(disturbances.agents())
