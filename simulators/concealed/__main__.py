"""python -m simulators.concealed --seed N --machine pps --effect NAME --size 1.0 --out DIR --sealed DIR2"""

from __future__ import annotations

import argparse
import secrets
import sys
from pathlib import Path

from simulators.concealed.case import make_case
from simulators.concealed.geometry import MACHINES


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="simulators.concealed", description="One concealed case and its sealed truth."
    )
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--machine", choices=MACHINES, default="pps")
    parser.add_argument("--effect", default="null", help="null, pair, unknown, an effect's name, or several as a+b")
    parser.add_argument(
        "--size", type=float, default=1.0, help="rms at the reflectors, in units of the repeatability's"
    )
    parser.add_argument("--visits", type=int, default=600)
    parser.add_argument("--fit", type=int, default=None, help="visits in the recording (default: three quarters)")
    parser.add_argument(
        "--remembers", type=float, default=0.0, metavar="R",
        help="correlation of a visit's scatter with that of the one before (default: 0)",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--sealed", type=Path, required=True, metavar="DIR")
    a = parser.parse_args()
    fit = round(0.75 * a.visits) if a.fit is None else a.fit
    try:
        seal = make_case(
            a.seed, a.machine, a.effect, a.size, a.out, a.sealed, a.visits, fit,
            salt=secrets.token_hex(16), remembers=a.remembers,
        )  # fmt: skip
    except (ValueError, OSError) as problem:
        print(f"simulators.concealed: {problem}", file=sys.stderr)
        return 2
    print(seal)
    return 0


if __name__ == "__main__":
    sys.exit(main())
