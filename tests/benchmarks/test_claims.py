"""The probe for depth, and the tables of the claims, from runs and records made by hand."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch as th

import benchmarks
from benchmarks.analysis import depth
from benchmarks.analysis.depth import read_positions
from benchmarks.tables import claims as claims_tables
from benchmarks.tables.cells import write
from benchmarks.tables.claims import BOTH, CLAIMS, depth_record, probe_missing, write_claims
from sb3_stereo.config.schema import load_config
from sb3_stereo.runs.creation import create_run
from sb3_stereo.runs.models import save_model, untrained_model


def test_what_is_linear_in_the_features_is_read_and_noise_is_not() -> None:
    rng = np.random.default_rng(0)
    positions = rng.uniform(-1, 1, (1000, 3))
    features = positions @ rng.normal(size=(3, 8)) + 5.0
    errors = read_positions(features, positions)
    assert errors.shape == (200,) and errors.max() < 1e-4
    noise, guess = (read_positions(f, positions) for f in (rng.normal(size=(1000, 8)), np.zeros((1000, 1))))
    assert np.median(noise) == pytest.approx(np.median(guess), rel=0.05)


def test_errors_are_of_poses_that_took_no_part_in_the_fit() -> None:
    rng = np.random.default_rng(0)
    features, positions = rng.normal(size=(100, 90)), rng.uniform(-1, 1, (100, 3))  # could be memorised
    assert np.median(read_positions(features, positions)) > 0.5


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that was not trained: the probe does not care."""
    config = load_config("ddpg", "WamStereoReachRandom-v0", env_kwargs={"max_episode_steps": 1})
    args = {"algo": "ddpg", "env": config.env_id, "seed": 0}
    run = create_run(tmp_path_factory.mktemp("logs"), config, args)
    save_model(untrained_model(config, "cpu", seed=3), run / f"{config.env_id}.zip")
    return run


def test_a_run_is_asked_for_depth(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert depth.main([str(run), "--poses", "200", "--json"]) == 0
    errors = [depth.Error(**line) for line in json.loads(capsys.readouterr().out)]
    sources = ["trained", "untrained", "a guess"]
    expected = [(point, source) for point in ("end effector", "target") for source in sources]
    assert [error[:2] for error in errors[:-1]] == expected
    assert errors[-1][:2] == ("end effector to target", "at the end of the test episodes")
    assert all(0 < error.median < error.quantile_95 < 250 for error in errors)
    assert errors[2].median > 30  # a guess is far away: the workspace is 2 m wide


def test_too_few_poses_are_an_error(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert depth.main([str(run), "--poses", "9"]) == 2
    assert capsys.readouterr().err == "error: --poses must be at least 100 and --seed not negative, got 9 and 0\n"


def test_every_row_can_be_trained() -> None:
    for row in CLAIMS:
        config = row.config()
        assert config.n_timesteps == row.checkpoints[-1]
        cameras = config.env_kwargs.get("cameras", [])
        assert list(cameras) == [row.name.rpartition("_")[2]] * len(cameras)
        untrained_model(config, "cpu")
    assert len({row.name for row in CLAIMS}) == len(CLAIMS)


def test_the_reference_path_computes_the_same_without_what_is_fast() -> None:
    rows = BOTH, next(row for row in CLAIMS if row.name == "fixed_reference")
    fast, reference = (untrained_model(row.config(), "cpu", seed=0).policy for row in rows)
    images = th.rand(8, 1, 84, 84, generator=th.Generator().manual_seed(0))
    features = [policy.encoder(images) for policy in (fast, reference)]
    th.testing.assert_close(*features)
    weights = [[p for p in policy.encoder.convs.parameters() if p.ndim == 4][1] for policy in (fast, reference)]
    assert [weight.is_contiguous() for weight in weights] == [False, True]
    assert [policy.critic.optimizer.defaults["fused"] for policy in (fast, reference)] == [True, False]


LINE = {"success_rate": "1.0", "mean_steps_success": "2.0", "mean_action": "0.5", "mean_q": "0.1", "versions": "v"}


def test_depth_is_a_mean_over_seeds_and_what_lacks_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmarks, "RESULTS", tmp_path / "results")
    row = CLAIMS[0]
    write(row.record, [{"seed": "0", "timesteps": str(step), **LINE} for step in row.checkpoints])
    probed = [
        {"seed": str(seed), "timesteps": "9", "point": "target", "source": "trained", "median": m, "quantile_95": q}
        for seed, m, q in ((0, "4.0", "10.0"), (1, "6.0", "12.0"))
    ]
    write(depth_record(row), probed)
    text = write_claims(tmp_path).read_text()
    assert f"| {row.label} | target | trained | 5.0 | 11.0 | 2 |" in text
    assert f"### {row.label}, 1 seed" in text and f"- {row.label}: " not in text
    assert f"- {CLAIMS[2].label}: `{' '.join(CLAIMS[2].command(0))}`" in text


def test_a_run_is_asked_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmarks, "RESULTS", tmp_path / "results")
    row, asked = replace(CLAIMS[0], name="made_up"), []
    write(row.record, [{"seed": "0", "timesteps": str(step), **LINE} for step in row.checkpoints])

    def probe(*args: object) -> list[depth.Error]:
        asked.append(args)
        return [depth.Error("target", "trained", 1.0, 2.0)]

    monkeypatch.setattr(claims_tables, "probe", probe)
    monkeypatch.setattr(claims_tables, "model_path", lambda run, env_id: run)
    monkeypatch.setattr(claims_tables, "find_trial", lambda folder, config, seed: folder)
    for _ in range(2):
        probe_missing([row], range(2), tmp_path)  # seed 1 is not trained
    assert len(asked) == 1
    assert depth_record(row).read_text().splitlines() == [
        "seed,timesteps,point,source,median,quantile_95",
        f"0,{row.checkpoints[-1]},target,trained,1.0,2.0",
    ]


def test_the_committed_claims_are_those_of_the_committed_records(tmp_path: Path) -> None:
    committed = Path(__file__).parents[2] / "benchmarks"
    assert write_claims(tmp_path).read_bytes() == (committed / "CLAIMS.md").read_bytes()
