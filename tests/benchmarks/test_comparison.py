"""The comparison's page, from records made by hand."""

from pathlib import Path

import pytest

import benchmarks
from benchmarks.tables.cells import Row, write
from benchmarks.tables.comparison import GOALS, ROWS, SCORED, first_enough, write_comparison
from benchmarks.tables.v1 import OURS
from sb3_stereo.evaluation.protocol import eval_initial_states


@pytest.fixture
def results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(benchmarks, "RESULTS", tmp_path / "results")
    return tmp_path


def record(row: Row, *success: tuple[float, ...]) -> None:
    """Record the success of some seeds at the steps of the comparison."""
    rest = {"mean_steps_success": "4.5", "within_5cm": "0.25", "versions": "v"}
    lines = [
        {"seed": str(seed), "timesteps": str(step), "success_rate": str(rate), **rest}
        for seed, rates in enumerate(success)
        for step, rate in zip(SCORED, rates)
    ]
    write(row.record, lines)


def test_a_row_shows_success_and_precision(results: Path) -> None:
    record(OURS, (0.5, 1, 1, 1), (0.7, 1, 1, 1))
    record(ROWS[2], (0, 0.01, 0.02, 0.03))
    page = write_comparison(results).read_text(encoding="utf-8")
    always = " | ".join(["100.0 (100 to 100)"] * 3)
    assert f"| **DDPG, ours** | 2 | 60.0 (50 to 70) | {always} | 4.50 | 25.0 | 4000 |" in page
    assert "| SAC | 1 | 0.0 | 1.0 | 2.0 | 3.0 | 4.50 | 25.0 | – |" in page
    assert "## Told what the image shows" not in page
    assert "Not measured yet: DDPG, TD3, TQC, PPO," in page


def test_enough_is_when_every_seed_has_it(results: Path) -> None:
    record(OURS, (0.95, 0.2, 0.2, 0.2), (0.0, 0.94, 0.96, 1.0))
    assert first_enough(OURS) == "6000"
    record(OURS, (0.95, 0.2, 0.2, 0.2), (0.0, 0.94, 0.94, 0.94))
    assert first_enough(OURS) == "–"


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_every_row_has_the_same_task_and_steps(row: Row) -> None:
    config = row.config()
    assert config.n_timesteps == SCORED[-1]
    own, v1 = (eval_initial_states(*task) for task in ((config.env_id, config.env_kwargs), ("WamStereoReach-v1", {})))
    assert str(own) == str(v1)
    assert (config.env_id == GOALS) == ("WithoutImages" in str(config.env_wrapper))
    if config.algo == "ppo":
        rollout = config.algo_kwargs["n_steps"] * config.n_envs
        assert all(step % rollout == 0 for step in SCORED)
