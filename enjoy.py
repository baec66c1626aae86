"""Run a trained agent; see `python enjoy.py --help`."""

import sys

from sb3_stereo.commands.enjoy import main

if __name__ == "__main__":
    sys.exit(main())
