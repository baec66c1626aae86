"""How many cores are free, and torch's threads that follow them."""

import os
import time
from collections.abc import Iterator

import pytest
import torch as th

from sb3_stereo import runtime
from sb3_stereo.runtime import CoreWatch, threads_for


@pytest.fixture(autouse=True)
def same_threads_after() -> Iterator[None]:
    before = th.get_num_threads()
    yield
    th.set_num_threads(before)


def optimizer_step() -> None:
    parameter = th.nn.Parameter(th.zeros(1))
    parameter.grad = th.ones(1)
    th.optim.Adam([parameter]).step()


@pytest.mark.parametrize(
    ("idle_or_ours", "free"), [(40.0, 4), (36.0, 4), (25.1, 3), (14.0, 1), (0.0, 1), (80.0, 4)], ids=str
)
def test_free_is_what_was_idle_or_ours(idle_or_ours: float, free: int, monkeypatch: pytest.MonkeyPatch) -> None:
    times = iter([(100.0, 7.0), (110.0, 7.0 + idle_or_ours)])
    monkeypatch.setattr(CoreWatch, "_seconds", lambda self: next(times))
    monkeypatch.setattr(runtime, "available_cores", lambda: 4)
    assert CoreWatch().free_cores() == free


def test_what_this_process_uses_is_free_for_it() -> None:
    watch = CoreWatch()
    used, (then, before) = time.process_time(), watch._before
    while time.process_time() < used + 0.3:
        pass
    now, after = watch._seconds()
    tick = 0.05
    assert 0.3 - tick <= after - before <= (os.cpu_count() or 1) * (now - then) + tick


@pytest.mark.parametrize("n_threads", [-1, 3])
def test_the_number_of_threads_is_put_back_afterwards(n_threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(CoreWatch, "free_cores", lambda self: 2)
    th.set_num_threads(1)
    with threads_for(n_threads, interval=0.0) as n:
        optimizer_step()
        assert th.get_num_threads() == n > 1
    optimizer_step()
    assert th.get_num_threads() == 1


def test_threads_follow_the_free_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    found = iter([3, 2, 1])
    monkeypatch.setattr(CoreWatch, "free_cores", lambda self: next(found))
    with threads_for(-1, interval=0.0) as n:
        assert n == th.get_num_threads() == 3
        for expected in (2, 1):
            optimizer_step()
            assert th.get_num_threads() == expected


def test_between_two_counts_an_interval_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(CoreWatch, "free_cores", lambda self: 2)
    with threads_for(-1, interval=1000.0):
        monkeypatch.setattr(CoreWatch, "free_cores", lambda self: 3)
        optimizer_step()
        assert th.get_num_threads() == 2


def test_a_number_that_is_told_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(CoreWatch, "free_cores", lambda self: 4)
    with threads_for(2, interval=0.0) as n:
        optimizer_step()
        assert n == th.get_num_threads() == 2
