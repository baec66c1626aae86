"""A run on disk: its directory, its models, and the state from which it resumes."""

from sb3_stereo.runs.directory import find_run, load_record

__all__ = ["find_run", "load_record"]
