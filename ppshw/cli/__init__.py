"""The command line: the composition root. One function per subcommand, nothing clever; parser.py has them all.

Exit codes: 0 success, 1 a failed run, 2 bad input. What went wrong is one line on stderr. Answers go to stdout, and
with --json nothing else does; prompts and progress go to stderr.
"""

from __future__ import annotations

import ppshw.process  # noqa: F401  # isort: skip  before numpy comes in with the rest

import logging
import os
import re
import signal
import sqlite3
import sys
from collections.abc import Sequence
from contextlib import suppress

from ppshw.cli.parser import build_parser
from ppshw.errors import PpshwError
from ppshw.interruptions import INTERRUPTIONS
from ppshw.whole_file import BAD_PATH

_NEGATIVE = re.compile(r"-[\d.][\d.eE+\-,; ]*")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    if argv is None:
        argv = sys.argv[1:]
        _as_a_program()
    if broken := next((word for word in argv if not _is_text(word)), None):
        return _complain(f"{broken}: a name that is no UTF-8 text, expected one that recordings and pages can hold", 2)
    # a leading space keeps argparse from taking -1e-3 or -0.1,2 for an option
    arguments = build_parser().parse_args([f" {word}" if _NEGATIVE.fullmatch(word) else word for word in argv])
    try:
        arguments.function(arguments)
    except PpshwError as error:
        return _complain(str(error), error.exit_code)
    except KeyboardInterrupt:
        return _complain("stopped", 1)
    except BrokenPipeError:
        return _nobody_listens()
    except OSError as error:
        message = f"{error.filename or 'file'}: {error.strerror or error}"
        return _complain(message, 2 if error.errno in BAD_PATH else 1)
    except sqlite3.Error as error:
        return _complain(f"recording: {error}", 1)
    except Exception as error:
        if os.environ.get("PPSHW_DEBUG"):
            raise
        return _complain(f"internal error: {type(error).__name__}: {error} (PPSHW_DEBUG=1 shows where)", 1)
    return 0


def _is_text(word: str) -> bool:
    """Whether a word can be written down: the bytes of a file's name may be of another encoding."""
    try:
        word.encode()
    except UnicodeEncodeError:
        return False
    return True


def _as_a_program() -> None:
    """What concerns the whole process: a polite kill stops the axes like Ctrl-C, which a shell that starts us with &
    has ignored; stderr is for our one line alone; what is written to a stream that was closed is lost."""
    for request_to_end in INTERRUPTIONS:
        signal.signal(request_to_end, signal.default_int_handler)
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115  as long as the process
    if sys.stdin is None:
        sys.stdin = open(os.devnull, encoding="utf-8")  # noqa: SIM115
    if not os.environ.get("PPSHW_DEBUG"):
        logging.captureWarnings(True)
        logging.getLogger().addHandler(logging.NullHandler())  # else Python prints the drivers' warnings itself
    with suppress(AttributeError):  # a terminal without our letters must not end in a traceback
        sys.stdout.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]


def _nobody_listens() -> int:
    """The exit code: somebody had enough of the answer (`| head`), or what we tell on the way goes nowhere."""
    try:
        sys.stdout.flush()  # again in vain, where the answer is what could not be written
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    return 1


def _complain(message: str, code: int) -> int:
    print(f"ppshw: {' '.join(message.split())}", file=sys.stderr)
    return code
