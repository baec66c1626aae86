"""The page on clutter is made from the records alone, and they are of what they say."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import benchmarks
from benchmarks.analysis import clutter, volume
from sb3_stereo.runs.directory import load_record
from sb3_stereo.runs.pretrained import pretrained_run

ROOT = Path(__file__).parents[2]


@pytest.fixture
def results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(benchmarks, "RESULTS", tmp_path / "results")
    return tmp_path


def lines(row: str, seed: str, success: float) -> list[dict[str, str]]:
    agent = {"row": row, "seed": seed, "timesteps": "8500", "cameras": "2"}
    cells = [("none", ""), ("none", "left"), ("none", "right"), ("not solid", ""), ("solid", "")]
    scores = {"success_rate": f"{success}", "mean_steps_capped": "12.25", "within_5cm": "0.5", "n_poses": "40"}
    return [agent | {"clutter": world, "lost": lost} | scores for world, lost in cells]


def test_the_page_has_a_row_per_agent_and_the_views_shares(results: Path) -> None:
    clutter.add_lines(lines("v1_robust_ddpg", "1", 0.5))
    clutter.add_lines(lines("v1_ours_ddpg", "2", 0.1))
    clutter.add_lines(lines("v1_ours_ddpg", "2", 0.2))  # in place of the line before
    views = [{"clutter": "none", "left": "0.975", "all": "0.9", "two or more": "1"}]
    found = [line for line in clutter.page(clutter.read_lines(clutter.record()), views).splitlines() if line[:1] == "|"]
    assert found == [
        "| agent | steps | cameras | poses | none | not solid | solid "
        "| none, each camera lost | solid, each camera lost |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        "| ours, clean images, trained without clutter | 8500 | 2 | 40 | 20 (12.2) | 20 (12.2) | 20 (12.2) "
        "| left 20, right 20 |  |",
        "| ours, augmented images, trained without clutter | 8500 | 2 | 40 | 50 (12.2) | 50 (12.2) | 50 (12.2) "
        "| left 50, right 50 |  |",
        "| clutter | left | all | two or more |",
        "| --- | --- | --- | --- |",
        "| none | 97.5 | 90.0 | 100.0 |",
    ]


@pytest.mark.parametrize("camera_loss", [0.0, 0.5])
def test_an_agent_is_scored_in_every_clutter_and_without_its_cameras_if_it_knows_that(
    camera_loss: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = pretrained_run("ddpg", "WamStereoReach-v1")
    config, arguments = load_record(run)
    trained = replace(config, env_kwargs={"camera_loss": camera_loss})
    monkeypatch.setattr(clutter, "load_record", lambda run: (trained, arguments))
    found = clutter.score_run(run, "v1_ours_ddpg", None, n_poses=1, n_envs=1)
    lost = ("", "left", "right") if camera_loss else ("",)
    worlds = [*(("none", one) for one in lost), ("not solid", ""), *(("solid", one) for one in lost)]
    assert [(line["clutter"], line["lost"]) for line in found] == worlds
    assert found[0]["success_rate"] == "1" and all(line["cameras"] == "2" for line in found)


def test_an_unknown_agent_is_refused(results: Path, capsys: pytest.CaptureFixture[Any]) -> None:
    assert clutter.main([str(pretrained_run("ddpg", "WamStereoReach-v1")), "--name", "mine"]) == 2
    assert "unknown name 'mine'; the table's agents are jacobian, random," in capsys.readouterr().err


def test_the_committed_page_is_that_of_the_committed_records() -> None:
    records = [clutter.read_lines(clutter.record(name)) for name in ("clutter", "clutter_views", "volume")]
    assert (ROOT / "benchmarks" / "CLUTTER.md").read_text() == clutter.page(*records)


def test_encoders_are_shown_with_every_camera_that_may_be_lost() -> None:
    encoders = [{"encoder": "stack", "all": "4.04", "left": "12.25"}]
    views = [{"clutter": "none", "left": "1"}]
    assert clutter.page([], views, encoders).splitlines()[-3:] == [
        "| encoder | all cameras | left lost |",
        "| --- | --- | --- |",
        "| stack | 4.0 | 12.2 |",
    ]


def test_an_encoder_is_trained_on_what_it_is_shown() -> None:
    """Each arrangement of the same few transitions gives errors, which fall with training."""
    few = volume.collect(12, camera_loss=0.0, seed=0)
    assert few.samples.observations.shape == (12, 4, 42, 84)
    for name in ("stack", "volume, mean"):
        before, after = (float(volume.errors(name, few, few, n)["all"]) for n in (1, 60))
        assert after < before
