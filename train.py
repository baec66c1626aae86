"""Train an agent; see `python train.py --help`."""

import sys

from sb3_stereo.commands.train import main

if __name__ == "__main__":
    sys.exit(main())
