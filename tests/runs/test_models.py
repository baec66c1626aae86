"""Models are loaded as they were saved, and nothing that a file holds is run, written or allowed to fill the memory."""

import io
import pickle
import resource
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fake_reach
import numpy as np
import pytest
import torch as th

from sb3_stereo.building.factory import make_model, make_training_env
from sb3_stereo.commands import evaluate
from sb3_stereo.config.schema import Config, load_config
from sb3_stereo.runs.creation import create_run
from sb3_stereo.runs.models import CHECKSUMS, load_model, load_weights, save_model

NETWORKS = {"n_filters": 4, "features_dim": 8, "embedding_dim": 3}


def config(algo: str = "ddpg", **networks: int) -> Config:
    values = load_config(algo, fake_reach.ENV_ID).plain()
    policy_kwargs = values["policy_kwargs"]
    policy_kwargs["features_extractor_kwargs"] |= NETWORKS | networks
    return load_config(algo, fake_reach.ENV_ID, params={"policy_kwargs": policy_kwargs, "buffer_size": 50})


def model(config: Config, seed: int = 0) -> Any:
    return make_model(config, make_training_env(config, seed), seed, "cpu")


@pytest.fixture
def run(logs: Path) -> Path:
    """A run directory with a model, as a training leaves it."""
    run = create_run(logs, config(), {"algo": "ddpg", "env": fake_reach.ENV_ID})
    save_model(model(config()), run / "FakeReach-v0.zip")
    return run


@pytest.mark.parametrize("algo", ["ddpg", "dqn"])
def test_a_loaded_model_acts_as_the_saved_one(algo: str, tmp_path: Path) -> None:
    saved = model(config(algo))
    save_model(saved, tmp_path / "model.zip")
    image = np.random.default_rng(0).integers(0, 256, (1, 60, 60), np.uint8)
    expected = saved.predict(image, deterministic=True)[0]
    for trust in (False, True):
        loaded = load_model(config(algo), tmp_path / "model.zip", "cpu", trust)
        np.testing.assert_array_equal(loaded.predict(image, deterministic=True)[0], expected)


def test_a_training_begins_with_another_ones_networks(tmp_path: Path) -> None:
    save_model(model(config(), seed=1), tmp_path / "model.zip")
    other = model(config(), seed=2)
    load_weights(other, tmp_path / "model.zip")
    for one, two in zip(other.policy.parameters(), model(config(), seed=1).policy.parameters(), strict=True):
        assert th.equal(one, two)


def test_checksums_are_those_of_sha256sum(run: Path) -> None:
    save_model(model(config(), seed=1), run / "best_model.zip")
    save_model(model(config(), seed=2), run / "best_model.zip")
    assert [line.split("  ")[1] for line in (run / CHECKSUMS).read_text().splitlines()] == [
        "FakeReach-v0.zip",
        "best_model.zip",
    ]
    if shutil.which("sha256sum"):
        subprocess.run(["sha256sum", "--check", "--quiet", CHECKSUMS], cwd=run, check=True)


class Evil:
    """Runs code when it is unpickled."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return (Path.touch, (self.file,))


def pickled(content: Any) -> bytes:
    buffer = io.BytesIO()
    th.save(content, buffer)
    return buffer.getvalue()


def with_entry(path: Path, name: str, content: bytes) -> None:
    """Replace one entry of a zip file."""
    with zipfile.ZipFile(path) as archive:
        entries = {info.filename: archive.read(info) for info in archive.infolist()} | {name: content}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for entry, data in entries.items():
            archive.writestr(entry, data)


def approve(run: Path) -> None:
    """What an attacker who can change the model can change as well: its checksum."""
    (run / CHECKSUMS).write_text("")
    from sb3_stereo.runs.files import sha256

    path = run / "FakeReach-v0.zip"
    (run / CHECKSUMS).write_text(f"{sha256(path)}  {path.name}\n")


def hostile_zips(run: Path) -> dict[str, Callable[[], Any]]:
    path, executed = run / "FakeReach-v0.zip", run / "executed"
    huge = {"a": th.zeros(1).expand(10**12)}
    return {
        "code in the weights": lambda: with_entry(path, "policy.pth", pickled({"a": Evil(executed)})),
        "code in an old-style pickle": lambda: with_entry(path, "policy.pth", pickle.dumps(Evil(executed))),
        "a bomb": lambda: with_entry(path, "policy.pth", bytes(300 * 2**20)),
        "a huge shape": lambda: with_entry(path, "policy.pth", pickled(huge)),
        "other networks": lambda: save_model(model(config(n_filters=5)), path),
        "half a file": lambda: path.write_bytes(path.read_bytes()[:1000]),
        "not a zip": lambda: path.write_bytes(b"#!/bin/sh\n"),
        "nothing": lambda: path.write_bytes(b""),
    }


@pytest.mark.filterwarnings("ignore:Detected pickle protocol")
@pytest.mark.parametrize("attack", list(hostile_zips(Path())))
def test_a_hostile_zip_is_one_sentence_and_nothing_else_happens(
    attack: str, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hostile_zips(run)[attack]()
    approve(run)
    before = sorted(run.parent.rglob("*"))
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert evaluate.main([str(run), "--poses", "1", "--num-threads", "1", "--n-envs", "1"]) == 2
    message = capsys.readouterr().err
    assert message.startswith(f"error: cannot load '{run / 'FakeReach-v0.zip'}': ")
    assert message.endswith("; choose a model of the same settings\n") and message.count("\n") == 1
    assert sorted(run.parent.rglob("*")) == before
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory < 100 * 2**10  # [KiB]


def test_code_in_the_settings_is_never_looked_at(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with_entry(run / "FakeReach-v0.zip", "data", pickle.dumps(Evil(run / "executed")))
    approve(run)
    assert evaluate.main([str(run), "--poses", "1", "--num-threads", "1", "--n-envs", "1"]) == 0
    assert not (run / "executed").exists()


def test_names_that_leave_the_folder_write_nothing(run: Path) -> None:
    with_entry(run / "FakeReach-v0.zip", "../../outside.txt", b"outside")
    approve(run)
    load_model(config(), run / "FakeReach-v0.zip", "cpu")
    assert not list(run.parents[2].rglob("outside.txt"))


def test_a_changed_model_and_one_from_elsewhere_need_trust(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = [str(run), "--poses", "1", "--num-threads", "1", "--n-envs", "1"]
    path = run / "FakeReach-v0.zip"
    way_out = "if you trust who made it, load it with --trust, which may run code that is in the file\n"
    model(config(), seed=9).save(path)
    assert evaluate.main(command) == 2
    assert capsys.readouterr().err == (
        f"error: '{path}' was changed after it was saved: SHA256SUMS beside it has another checksum; {way_out}"
    )
    (run / CHECKSUMS).unlink()
    assert evaluate.main(command) == 2
    assert capsys.readouterr().err == (
        f"error: '{path}' is not from a run: no SHA256SUMS beside it names it; {way_out}"
    )
    assert evaluate.main([*command, "--trust"]) == 0


def test_a_kill_between_the_model_and_its_checksum_leaves_a_model_that_loads(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from sb3_stereo.runs import models

    class Killed(BaseException):
        pass

    def killed(*args: Any) -> None:
        raise Killed

    path = run / "FakeReach-v0.zip"
    for moment in ("publish", "sha256"):
        with monkeypatch.context() as patch, pytest.raises(Killed):
            patch.setattr(models, moment, killed)
            save_model(model(config(), seed=4), path)
        load_model(config(), path, "cpu")
    real = models.publish

    def publish_and_die(*args: Any) -> None:
        real(*args)
        raise Killed

    with monkeypatch.context() as patch, pytest.raises(Killed):
        patch.setattr(models, "publish", publish_and_die)
        save_model(model(config(), seed=5), path)
    load_model(config(), path, "cpu")


FULL_DISK = """
import resource, sys
from sb3_stereo.runs import snapshots
from sb3_stereo.commands import train
real = snapshots.save
def save(run, step, state):
    size = real(run, step, state).stat().st_size + 1000
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
snapshots.save = save
sys.exit(train.main(sys.argv[1:]))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="file size limits")
def test_a_full_disk_is_one_sentence_and_leaves_what_was_there(logs: Path) -> None:
    """The limit of a process's files stands for the end of the disk; the next snapshot is larger."""
    flags = ["--env", fake_reach.ENV_ID, "--gym-packages", "fake_reach", "-f", str(logs), "--num-threads", "1"]
    flags += ["-n", "60", "--save-freq", "20", "--verbose", "0", "-params", "learning_starts:200", "buffer_size:100"]
    command = [sys.executable, "-c", FULL_DISK, *flags]
    done = subprocess.run(command, cwd=Path(fake_reach.__file__).parent, capture_output=True, text=True, check=False)
    run = logs / "ddpg" / "FakeReach-v0_1"
    assert done.returncode == 2
    assert done.stderr.startswith(f"error: cannot write to '{run}' (File too large); ")
    assert [path.name.partition("-")[0] for path in (run / "checkpoints").iterdir()] == ["step_20"]
