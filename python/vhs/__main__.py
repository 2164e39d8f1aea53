"""``python -m vhs`` is the command line, as `torchrun -m vhs` starts it."""

import sys

from vhs.cli import main

if __name__ == "__main__":
    sys.exit(main())
