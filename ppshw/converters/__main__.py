"""`python -m ppshw.converters {hilti,ur10,ur5} SRC OUT`; bad input is one line on stderr and exit code 2."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from ppshw.cli.answers import new_file
from ppshw.converters import hilti, ur5, ur10
from ppshw.errors import PpshwError
from ppshw.whole_file import BAD_PATH


def main(argv: Sequence[str] | None = None) -> int:
    args = _parser().parse_args(argv)
    try:
        new_file("csv", args.out, args.source)
        if args.dataset == "hilti":
            visits = hilti.convert(args.source, args.out)
        elif args.dataset == "ur10":
            visits = ur10.convert(args.source, args.out, with_orientation=args.with_orientation)
        else:
            visits = ur5.convert(args.source, args.out)
    except PpshwError as exc:
        print(exc, file=sys.stderr)
        return exc.exit_code
    except OSError as exc:
        print(f"{exc.filename or args.out}: {exc.strerror or exc}", file=sys.stderr)
        return 2 if exc.errno in BAD_PATH else 1
    print(f"{args.out}: {visits} visits")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m ppshw.converters", description=__doc__)
    sets = parser.add_subparsers(dest="dataset", required=True, metavar="{hilti,ur10,ur5}")
    for name, module in (("hilti", hilti), ("ur10", ur10), ("ur5", ur5)):
        sub = sets.add_parser(name, help=(module.__doc__ or "").splitlines()[0])
        sub.add_argument("source", type=Path, help="the published file")
        sub.add_argument("out", type=Path, help="the CSV to write")
        if name == "ur10":
            sub.add_argument(
                "--with-orientation",
                action="store_true",
                help="two more targets, 100 mm along the T-Mac's x and y axes (machines/real/ur10_pose.yaml)",
            )
    return parser


if __name__ == "__main__":
    sys.exit(main())
