"""Duration of a gradient step when other processes take the cores of its threads.

    python -m benchmarks.speed.crowded

prepares training runs on a machine that should be quiet, times gradient steps of each, then again next to one busy
process per core, and prints the milliseconds.

    python -m benchmarks.speed.crowded THREADS

is one of these runs, for the above: -1 follows the free cores.
"""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from benchmarks.speed.timing import Worker, medians, serve, timed
from sb3_stereo.runtime import MAX_THREADS, available_cores, threads_for, tune_allocator

ROUNDS = 3
N_UPDATES = 20  # per time
TRAININGS = {"1 thread": "1", f"{MAX_THREADS} threads": str(MAX_THREADS), "the free cores (the default)": "-1"}


@contextmanager
def busy_processes(n: int) -> Iterator[None]:
    """Meanwhile, others use `n` cores."""
    others = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(n)]
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.wait()


def measure(rounds: int = ROUNDS) -> dict[str, tuple[float, ...]]:
    """Milliseconds per gradient step of each training, alone and beside others."""
    with ExitStack() as stack:
        candidates = {}
        for name, threads in TRAININGS.items():  # one after the other: each finds the cores free
            worker = stack.enter_context(Worker("benchmarks.speed.crowded", threads))
            candidates[name] = worker.candidate("gradient steps")
            candidates[name]()
        alone = medians(candidates, rounds)
        with busy_processes(available_cores()):
            crowded = medians(candidates, rounds)
    return {name: tuple(1000 * seconds[name] / N_UPDATES for seconds in (alone, crowded)) for name in candidates}


def serve_training(num_threads: int) -> None:
    """Be one of the training runs."""
    from benchmarks.speed.trainings import make_training

    model, _ = make_training()
    with threads_for(num_threads):
        serve({"gradient steps": timed(lambda: model.train(gradient_steps=N_UPDATES, batch_size=model.batch_size))})


def main() -> None:
    """Command line."""
    if len(sys.argv) > 1:
        tune_allocator()
        serve_training(int(sys.argv[1]))
        return
    print(f"| ms per gradient step | alone | beside {available_cores()} busy processes |\n| --- | --- | --- |")
    for name, (alone, crowded) in measure().items():
        print(f"| {name} | {alone:.3g} | {crowded:.3g} |")


if __name__ == "__main__":
    main()
