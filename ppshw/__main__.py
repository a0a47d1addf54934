"""`python -m ppshw`, the same as `ppshw`."""

import sys

from ppshw.cli import main

if __name__ == "__main__":
    sys.exit(main())
