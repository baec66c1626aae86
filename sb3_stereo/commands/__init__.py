"""The commands, one file each: what `python -m sb3_stereo COMMAND` calls."""
