"""The script that measures how a sweep scales: its sweeps are valid, and its table is the one worked out by hand."""

from pathlib import Path

import pytest
import yaml

from benchmarks.speed.scaling import QUICK, SWEEP, report
from sb3_stereo.tuning.config import load_sweep


@pytest.mark.parametrize("changes", [{}, QUICK])
def test_its_sweep_is_one_setting_with_several_seeds(changes: dict[str, object], tmp_path: Path) -> None:
    file = tmp_path / "scaling.yml"
    file.write_text(yaml.safe_dump(SWEEP | changes))
    sweep = load_sweep(file)
    (parameter,) = sweep.parameters
    assert len(parameter.values) == 1 and len(sweep.seeds) >= 2
    assert sweep.early_terminate is None and sweep.base.algo_kwargs["learning_starts"] < sweep.base.n_timesteps


def test_speed_ups_are_over_one_worker() -> None:
    seconds = {"1": {"trainings": 80.0, "command": 100.0}, "4": {"trainings": 20.0, "command": 40.0}}
    facts = {"n_trials": 8, "n_timesteps": 200, "machine": "4 cores", "load": "load 0.1 before", "versions": "Python 3"}
    text = report({"seconds": seconds, **facts})
    assert "| 1 | 80 | 1.00 | 100 | 1.00 |\n| 4 | 20 | 4.00 | 40 | 2.50 |\n" in text
    assert text.endswith("\nOn 4 cores, load 0.1 before; Python 3.\n")
