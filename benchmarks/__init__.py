"""Measurements: each module is a command that prints what it measured."""

from pathlib import Path

FOLDER = Path(__file__).parent
RESULTS = FOLDER / "results"  # committed records, from which the tables are made
