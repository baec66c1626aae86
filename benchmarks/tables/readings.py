"""Rows of the paper's settings on other readings of its text: of the task, under which its numbers appear, and of the
training.

They are trained by `benchmarks.tables.paper` and shown below the rows of the default reading.
"""

from dataclasses import dataclass

from benchmarks.analysis.baselines import TASKS, Task
from benchmarks.tables.cells import Row

DDPG_CHECKPOINTS = (1500, 2000, 5000, 7000, 8500)  # Table 3
OUR_CHECKPOINTS = (1500, 2000, 3000, 5000, 7000, 8500)
DQN_CHECKPOINTS = (1500, 3500, 5500, 7500, 10000)  # Table 4


@dataclass(frozen=True)
class Reading:
    """One way to read what the paper leaves open.

    Attributes:
        task: The environment.
        title: Of its section.
        short: Of its panel in the picture.
        text: Which sentence is read how.
        flags: Of `train.py`, the task's `--env-kwargs`.
    """

    task: Task
    title: str
    short: str
    text: str
    flags: tuple[str, ...]

    def row(self, algo: str, gamma: float) -> Row:
        """Table 1 or 2 with a discount."""
        name = {"ddpg": "DDPG, Table 1", "dqn": "DQN, Table 2"}[algo]
        params = ("--env-kwargs", *self.flags, "-params", f"gamma:{gamma}")
        checkpoints = DDPG_CHECKPOINTS if algo == "ddpg" else DQN_CHECKPOINTS
        arguments = ("-conf", f"hyperparams/paper/{algo}.yml", *params)
        return Row(f"{self.task.name}_{algo}_gamma_{gamma}", algo, f"{name}, γ {gamma}", arguments, checkpoints)

    @property
    def ours(self) -> Row:
        """Our DDPG."""
        arguments = ("--eval-freq", "500", "--env-kwargs", *self.flags)
        return Row(f"{self.task.name}_ours_ddpg", "ddpg", "**DDPG, ours**", arguments, OUR_CHECKPOINTS)

    @property
    def rows(self) -> tuple[Row, ...]:
        """All of its rows, DDPG's first."""
        return self.row("ddpg", 0.99), *(self.row("dqn", gamma) for gamma in (0.2, 0.5, 0.9)), self.ours


_TASKS = {task.name: task for task in TASKS}
READINGS = (
    Reading(
        _TASKS["observation"],
        "ρ = 10 px in the 84×42 views",
        "ρ = 10 px of 84×42",
        "“320×240 RGB images captured by the cameras are resized to 84×42” (section 3.2), read before “we detect these "
        "color blobs from the images” (3.3): ρ counts in pixels of the resized views. All else is the default's, also "
        "the reward but for its goal.",
        ("success_frame:observation",),
    ),
    Reading(
        _TASKS["long_pulses"],
        "Pulses of 1.5 s and a target where a full constant effort ends",
        "pulses of 1.5 s, another target",
        "“Continuous efforts applied at each joint” (section 3.1) names no duration, and the place of the target is "
        "not given: pulses of 1.5 s, target at (0.634, 0.421, 0.227) m, ρ = 10 px of the cameras' frames.",
        ("pulse_duration:1.5", "target_position:[0.634,0.421,0.227]"),
    ),
    Reading(
        _TASKS["observation_close"],
        "ρ = 10 px in the 84×42 views, v1's framing",
        "ρ = 10 px of 84×42, close",
        "The first of these readings with the cameras of `WamStereoReach-v1`, as the paper leaves their place open.",
        ("success_frame:observation", "framing:close"),
    ),
)
READING_ROWS = tuple(row for reading in READINGS for row in reading.rows)


N_RANDOM = 28.6  # steps of an episode of random actions on the default task, `baselines_strict.csv`


def _training_row(name: str, label: str, *params: str, checkpoints: tuple[int, ...]) -> Row:
    """Table 1 on the default task, trained otherwise."""
    arguments = ("-conf", "hyperparams/paper/ddpg.yml", "-params", "gamma:0.99", *params)
    return Row(f"paper_ddpg_{name}", "ddpg", f"DDPG, Table 1, γ 0.99, {label}", arguments, checkpoints)


TRAINING_ROWS = (
    _training_row(
        "episodes",
        "t counts episodes",
        f"learning_starts:{1000 * N_RANDOM:.0f}",
        f"exploration.n_steps:{10_000 * N_RANDOM:.0f}",
        checkpoints=(round(1500 * N_RANDOM),),
    ),
    _training_row(
        "acting_statistics",
        "batch statistics when acting",
        "policy_kwargs.acting_statistics:observation",
        checkpoints=DDPG_CHECKPOINTS,
    ),
)
