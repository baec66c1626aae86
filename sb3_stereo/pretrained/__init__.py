"""Trained agents that ship with the package: a log folder of runs, with the final model in half precision.

`python -m benchmarks.export RUN` writes them. This module exists because an editable install cannot import the folder
without it.
"""

from pathlib import Path

FOLDER = Path(__file__).parent
