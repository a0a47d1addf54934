"""The person at the bench, as a port: puts loads on, and may pause, skip, redo or abort between two visits.

`ConsoleOperator` asks at the terminal; `AutomaticOperator` hands the load to whatever carries it out (a simulated
plant, a loading rig) and answers at once. What was asked and answered goes into the recording: name, time and mass.
"""

from __future__ import annotations

import enum
import re
import select
import sys
import termios
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TextIO

from campaigns.script import LoadCase
from ppshw.errors import Stopped


class Command(enum.Enum):
    PAUSE = "p"
    GO_ON = "g"
    SKIP = "s"
    REDO = "r"
    ABORT = "a"


# What a person says who wants something else than to answer with a name. After a name the machine moves.
_NO_NAMES = {
    "abort", "again", "break", "cancel", "continue", "done", "exit", "finished", "go", "halt", "help", "inf", "kg",
    "later", "no", "nothing", "ok", "okay", "pause", "quit", "ready", "redo", "resume", "retry", "skip", "start",
    "stop", "wait", "yes",
}  # fmt: skip
_WITH_MASS = re.compile(r"(?P<name>.*?)(?:^|[\s,;:])(?P<mass>\d{1,6}(?:[.,]\d{1,6})?)\s*(?:kg)?\.?", re.IGNORECASE)


@dataclass(frozen=True)
class Answer:
    """Who put the load on, and the mass that really lies there if it is not the one asked for [kg]."""

    name: str
    mass: float | None = None


class Operator(Protocol):
    def change_load(self, load: LoadCase) -> Answer:
        """Take off what is there, put this on; returns when it is done. Raises Stopped when the operator gives up."""

    def command(self) -> Command | None:
        """What was asked for since the last call; asked between visits, never waits."""

    def wait_for_command(self, why: str) -> Command:
        """Say why the run stands still, wait for the next command."""

    def tell(self, text: str) -> None: ...


class AutomaticOperator:
    """Nobody to ask. `put_on` carries the load change out; a standstill that wants a decision is an abort."""

    def __init__(self, put_on: Callable[[LoadCase], None] | None = None, name: str = "automatic") -> None:
        self._put_on = put_on
        self._name = name

    def change_load(self, load: LoadCase) -> Answer:
        if self._put_on is not None:
            self._put_on(load)
        return Answer(self._name, load.mass)

    def command(self) -> Command | None:
        return None

    def wait_for_command(self, why: str) -> Command:
        return Command.ABORT

    def tell(self, text: str) -> None:
        """Nobody listens; the event log has it."""


class ConsoleOperator:
    """Asks on `out`, reads lines from `lines`. One letter and Enter while a campaign runs: p (then g), s, r, a."""

    def __init__(self, lines: TextIO | None = None, out: TextIO | None = None) -> None:
        self._lines = lines or sys.stdin
        self._out = out or sys.stderr
        self._name = ""

    def change_load(self, load: LoadCase) -> Answer:
        stopped = f"stopped by the operator at the change to load {load.name}"
        if self._drop_what_was_typed():
            raise Stopped(stopped)
        what = "everything off the couch" if load.mass == 0 else _describe(load)
        self.tell(f"\nLoad change: {what}.")
        mass: float | None = None  # said already, while the name is still asked for
        known = self._name
        while True:
            default = f" [{known}]" if known else ""
            line = self._ask(f"Your name{default}, then the mass in kg if another; Enter when done, 'abort' to stop: ")
            if _is_abort(line):
                raise Stopped(stopped)
            name, said, problem = _read_answer(line)
            if problem:
                known = ""  # who wanted to stop and presses Enter again has not said that it is done
                self.tell(f"{problem}; to stop type 'abort'. To pause, skip and redo there is time between two visits.")
                continue
            known, mass = name or known, mass if said is None else said
            if not known:
                self.tell("A name is needed" + ("." if mass is None else f"; {mass:g} kg is noted."))
            elif mass in (None, load.mass) or self._confirmed(mass, load, stopped):
                self._name = known
                return Answer(known, load.mass if mass is None else mass)
            else:
                mass = None

    def _confirmed(self, mass: float, load: LoadCase, stopped: str) -> bool:
        """A mass is mistyped as easily as the wrong load is put on."""
        while True:
            said = self._ask(f"{mass:g} kg instead of {load.mass:g} kg: is that so? y or n: ").lower()
            if _is_abort(said):
                raise Stopped(stopped)
            if said in ("y", "yes", "n", "no"):
                return said[0] == "y"

    def command(self) -> Command | None:
        return self._parse(self._lines.readline()) if self._something_typed() else None

    def wait_for_command(self, why: str) -> Command:
        self.tell(f"\n{why}")
        while True:
            found = self._parse(self._ask("g go on, s skip this visit, r redo the last one, a abort: "))
            if found is not None and found is not Command.PAUSE:
                return found

    def tell(self, text: str) -> None:
        print(text, file=self._out, flush=True)

    def _something_typed(self) -> bool:
        return self._lines.isatty() and bool(select.select([self._lines], [], [], 0)[0])

    def _drop_what_was_typed(self) -> bool:
        """Before a question: what was typed until then is no answer to it. True where it was an abort."""
        while self._something_typed() and (line := self._lines.readline()):
            if _is_abort(line):
                return True
            if line.strip():
                self.tell(f"'{line.strip()}' was typed before the question and is not taken.")
        if self._lines.isatty():
            termios.tcflush(self._lines.fileno(), termios.TCIFLUSH)  # half a line
        return False

    def _ask(self, prompt: str) -> str:
        print(prompt, end="", file=self._out, flush=True)
        line = self._lines.readline()
        if not line:
            raise Stopped("stopped: nobody answers at the terminal (end of input)")
        return line.strip()

    def _parse(self, line: str) -> Command | None:
        """A command by its letter or its word; anything else is none, and said to be none."""
        said = _bare(line)
        for command in Command:
            if said in (command.value, command.name.lower().replace("_", " ")):
                return command
        if said:
            self.tell(f"'{line.strip()}' is no command: p pause, g go on, s skip, r redo, a abort.")
        return None


def _describe(load: LoadCase) -> str:
    x, y, z = load.com
    return f"put on '{load.name}': {load.mass:g} kg, centre at ({x:g}, {y:g}, {z:g}) m on the couch"


def _bare(text: str) -> str:
    """Without what somebody adds who means it."""
    return text.strip().strip("!.'\"").lower()


def _is_abort(line: str) -> bool:
    return _bare(line) in (Command.ABORT.value, "abort")


def _read_answer(line: str) -> tuple[str, float | None, str]:
    """The name, the mass [kg], and why the line is no answer ("" where it is one): "Ann", "148,5", "Ann 148 kg"."""
    found = _WITH_MASS.fullmatch(line)
    name, mass = (line, None) if found is None else (found["name"], float(found["mass"].replace(",", ".")))
    words = name.strip(",;: ").split()
    if any(letter.isdigit() for letter in name):
        return "", None, f"'{line}' is not understood; expected a name, then a mass such as 148.5 kg"
    if len(words) == 1 and len(words[0]) == 1 and words[0].isascii():
        return "", None, f"'{words[0]}' is no name"
    for word in words:
        if _bare(word) in _NO_NAMES or not any(letter.isalpha() for letter in word):
            return "", None, f"'{word}' is no name"
    return " ".join(words), mass, ""
