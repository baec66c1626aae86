"""Sections of the report on other readings of the paper: their rows, and which published cells they match."""

from collections.abc import Iterable, Sequence

import numpy as np

from benchmarks.analysis.baselines import read_lines
from benchmarks.analysis.looks import looks_record
from benchmarks.tables.cells import Row, read
from benchmarks.tables.readings import N_RANDOM, READINGS, TRAINING_ROWS
from benchmarks.tables.row_tables import PUBLISHED, by_checkpoint, line_of, mean, table, with_interval
from sb3_stereo.evaluation.intervals import Floats, interval

READINGS_PICTURE = "readings.svg"
TEXT = """The paper's settings to the letter (Tables 1 and 2), on tasks that its text allows as well as the default one.
Nothing here says what its authors did: only under which readings numbers like theirs appear.
"""


def reading_sections(rows: Iterable[Row]) -> list[str]:
    """A section for each reading of which some row is recorded."""
    measured = [row for row in rows if read(row.record)]
    sections = []
    for reading in READINGS:
        chosen = [row for row in reading.rows if row in measured]
        if chosen:
            sections.append(
                f"### Reading: {reading.title}\n\n{reading.text}\n\n{matches(chosen)}{table(chosen, level=4)}"
            )
    picture = f"![Success under the readings]({READINGS_PICTURE})\n"
    if not sections:
        return []
    return [
        f"## Other readings of the paper\n\n{TEXT}",
        picture,
        *sections,
        *training_section(measured),
        *looks_table(),
    ]


TRAINING_TEXT = f"""The default task, with Table 1. In Algorithm 1, t counts the outer loop, so it may count episodes.
Then the replay memory is filled for 1 000 episodes of random actions ({N_RANDOM} steps each on average), an update
follows every environment step after that, and the 1 500 of Table 3 are {1500 * N_RANDOM:.0f} steps. Batch normalisation
in Torch7 uses the statistics of its input unless told otherwise, so an agent may act by those of a single image
(`acting_statistics: observation`). Then every normalised fully connected layer returns its bias, and the action is the
same whatever the image.
"""


def training_section(measured: Iterable[Row]) -> list[str]:
    """A section on other readings of the training, of which some row is recorded."""
    chosen = [row for row in measured if row in TRAINING_ROWS]
    return [f"### Readings of the training\n\n{TRAINING_TEXT}\n{table(chosen, level=4)}"] if chosen else []


def matches(rows: Sequence[Row]) -> str:
    """A table of the published cells beside the measured ones."""
    head = ["row", "environment steps", "published", "measured", "steps published", "steps measured", "matched"]
    lines = [line for row in rows if row.name in PUBLISHED for line in _matches_of(row)]
    if not lines:
        return ""
    text = "\n".join(map(line_of, [head, ["---"] * len(head), *lines]))
    return f"{MATCHED_TEXT}\n\n{text}\n\n"


MATCHED_TEXT = "A cell is matched if the interval over seeds holds the published success; one seed has no interval."


def _matches_of(row: Row) -> list[list[str]]:
    success = [100 * values for values in by_checkpoint(row, "success_rate")]
    columns = zip(row.checkpoints, *PUBLISHED[row.name], success, by_checkpoint(row, "mean_steps_success"), strict=True)
    return [
        [row.label, str(step), f"{published:g} %", with_interval(found), f"{published_steps:g}", mean(steps), verdict]
        for step, published, published_steps, found, steps in columns
        if (verdict := match(published, found))
    ]


def match(published: float, success: Floats) -> str:
    """Whether a published success is within the interval of the measured ones; empty if nothing was measured."""
    if not len(success):
        return ""
    if len(success) == 1:
        return "equal, one seed" if np.isclose(success[0], published) else "one seed"
    low, high = interval(success)
    return "yes" if low - 1e-9 <= published <= high + 1e-9 else "no"


LOOKS_TEXT = """`python -m benchmarks.analysis.looks` plays the test starts again with every observation replaced by one
of another episode. An agent that looks at the image needs its own; the spread is the efforts' standard deviation over
its own images, mean over the joints (0: one action, whatever is seen; full efforts drawn at random have 1).
"""
LABELS = {row.name: f"{row.label.strip('*')}; {reading.title}" for reading in READINGS for row in reading.rows}


def looks_table() -> list[str]:
    """A section on whether the recorded agents look at the image."""
    head = ["agent", "seed", "environment steps", "success, %", "shuffled, %", "steps", "shuffled steps", "spread"]
    lines = [
        [
            LABELS.get(entry["row"], entry["row"]),
            entry["seed"],
            entry["timesteps"],
            *(f"{100 * float(entry[name]):.0f}" for name in ("success_rate", "shuffled_success_rate")),
            *(f"{float(entry[name]):.2f}" for name in ("mean_steps_capped", "shuffled_mean_steps_capped")),
            f"{float(entry['action_spread']):.2f}",
        ]
        for entry in read_lines(looks_record())
    ]
    if not lines:
        return []
    text = "\n".join(map(line_of, [head, ["---"] * len(head), *lines]))
    return [f"### Does it look at the image?\n\n{LOOKS_TEXT}\n{text}\n"]
