"""Whatever goes wrong at whichever write, and again after each resumption: the run ends as if nothing had happened."""

import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import faulty_disk
import pytest
from comparing import assert_same_runs
from faulty_disk import FaultyDisk, Killed, every
from tiny_training import tiny_config

from sb3_stereo.errors import ConfigError
from sb3_stereo.evaluation.protocol import random_initial_states
from sb3_stereo.runs.status import has_ended
from sb3_stereo.training import Options, Result, resume, session, train

CONFIG = tiny_config(n_timesteps=24, learning_starts=4, gradient_steps=1)
MAX_FAULTS = 500


@pytest.fixture(autouse=True)
def ctrl_c_is_heard() -> Iterator[None]:
    """A shell has its background jobs ignore Ctrl-C."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(autouse=True)
def few_initial_states(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "eval_initial_states", lambda *_: random_initial_states(3, seed=0))


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(session, "eval_initial_states", lambda *_: random_initial_states(3, seed=0))
        return train(CONFIG, options(tmp_path_factory.mktemp("logs"))).run


def options(logs: Path) -> Options:
    return Options(seed=3, log_folder=str(logs), eval_freq=10, save_freq=8, device="cpu", verbose=0)


def go_on(logs: Path) -> Result:
    """What a user does: train, and resume what is there."""
    runs = list(logs.glob("ddpg/FakeReach-v0_*"))
    return resume(runs[0], verbose=0) if runs else train(CONFIG, options(logs))


def train_with_faults(logs: Path, disk: FaultyDisk) -> tuple[Path, int]:
    """Train until the run has ended; return it, and how often it did not."""
    for n_faults in range(MAX_FAULTS):
        disk.restart()
        try:
            result = go_on(logs)
        except Killed:
            continue
        except ConfigError as error:
            assert str(error).endswith("there is nothing to resume") or "No space left on device" in str(error)
            if "No space" in str(error):
                continue
            return next(logs.glob("ddpg/FakeReach-v0_*")), n_faults
        assert has_ended(result.run, CONFIG) == (result.interrupted is None)
        if result.interrupted is None:
            return result.run, n_faults
    raise AssertionError("it does not end")


FAULTS = [faulty_disk.kill, faulty_disk.kill_after, faulty_disk.fill, faulty_disk.interrupt]


def check(
    fault: Callable[..., Any],
    chosen: Callable[[int], bool],
    logs: Path,
    undisturbed: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with monkeypatch.context() as patch:
        run, n_faults = train_with_faults(logs, FaultyDisk(patch, logs, fault, chosen))
    assert n_faults > 1
    assert_same_runs(run, undisturbed)


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_at_some_writes_change_nothing(
    fault: Callable[..., Any], logs: Path, undisturbed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    check(fault, every(9, FAULTS.index(fault)), logs, undisturbed, monkeypatch)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_at_each_write_changes_nothing(
    fault: Callable[..., Any], logs: Path, undisturbed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    check(fault, every(1), logs, undisturbed, monkeypatch)
