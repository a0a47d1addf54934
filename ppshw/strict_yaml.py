"""YAML files read strictly: an unknown key, a wrong type or a nan is one line with file, line and what was expected.

The same reader serves machine files, campaign scripts and site files. After Klipper's `check_unused`: an option that
nobody read is an error, because it is a typing mistake far more often than a wish.
"""

from __future__ import annotations

import math
import re
import unicodedata
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import yaml
from numpy.typing import NDArray

from ppshw.errors import BadInput

REQUIRED: Any = object()
# Nothing in these files is larger than a time of day in seconds; beyond, squares of lengths would overflow.
LARGEST = 1e12
NUMBERS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
OTHER_BASE = re.compile(r"[_:]|^[-+]?0[0-7]+$")
NOTHING = "tag:yaml.org,2002:null"  # what stands for an optional key that is not there


class Section:
    """One mapping of a YAML file. Every read is checked; `done()` complains of keys that nobody read."""

    def __init__(self, node: yaml.MappingNode, file: Path, where: str, error: type[BadInput]) -> None:
        self._file, self._where, self._error = file, where, error
        self.line = node.start_mark.line + 1
        self._nodes: dict[str, yaml.Node] = {}
        self._read: set[str] = set()
        for key_node, value_node in node.value:
            key = str(key_node.value)
            if key in self._nodes:
                self._fail(key_node, f"duplicate key '{self._path(key)}'")
            self._nodes[key] = value_node

    # --- what is there -------------------------------------------------------------------------------------
    def __contains__(self, key: str) -> bool:
        return key in self._nodes

    def keys(self) -> list[str]:
        return list(self._nodes)

    def done(self) -> None:
        """Raise if any key was never asked for."""
        for key, node in self._nodes.items():
            if key not in self._read:
                known = ", ".join(sorted(self._read))
                comma = "; a decimal comma?" if key.isdigit() else ""
                self._fail(node, f"unknown key '{self._path(key)}' (known here: {known}){comma}")

    # --- scalars -------------------------------------------------------------------------------------------
    def number(self, key: str, default: Any = REQUIRED, low: float = -math.inf, high: float = math.inf) -> Any:
        """A finite number within [low, high]."""
        node = self._take(key, default is not REQUIRED, "a number")
        if node is None:
            return default
        value = self._as_number(node, key)
        if not low <= value <= high:
            self._fail(node, f"'{self._path(key)}' is {value:g}, expected {_range(low, high)}")
        return value

    def integer(self, key: str, default: int = REQUIRED, low: int = -(2**31), high: int = 2**32) -> int:
        node = self._take(key, default is not REQUIRED, "a whole number")
        if node is None:
            return default
        self._refuse_other_bases(node, key)
        value = _construct(node)
        if not isinstance(value, int) or isinstance(value, bool):
            self._fail(node, f"'{self._path(key)}' is {_show(value)}, expected a whole number")
        if not low <= value <= high:
            self._fail(node, f"'{self._path(key)}' is {value}, expected {_range(low, high)}")
        return int(value)

    def text(self, key: str, default: Any = REQUIRED, choices: tuple[str, ...] = ()) -> str:
        node = self._take(key, default is not REQUIRED, "a text")
        if node is None:
            return str(default)
        value = _construct(node)
        if not isinstance(value, str) or not value or "\0" in value:  # which no name of a file may hold
            self._fail(node, f"'{self._path(key)}' is {_show(value)}, expected a text")
        if choices and value not in choices:
            self._fail(node, f"'{self._path(key)}' is '{value}', expected {' or '.join(choices)}")
        return str(value)

    def flag(self, key: str, default: bool = REQUIRED) -> bool:
        node = self._take(key, default is not REQUIRED, "true or false")
        if node is None:
            return default
        value = _construct(node)
        if not isinstance(value, bool):
            self._fail(node, f"'{self._path(key)}' is {_show(value)}, expected true or false")
        return bool(value)

    # --- several values ------------------------------------------------------------------------------------
    def vector(self, key: str, size: int | None, default: Any = REQUIRED) -> NDArray[np.float64]:
        """`size` finite numbers (any number of them with None)."""
        wanted = f"{size} numbers" if size is not None else "a list of numbers"
        node = self._take(key, default is not REQUIRED, wanted)
        if node is None:
            return np.array(default, dtype=float)
        if not isinstance(node, yaml.SequenceNode) or (size is not None and len(node.value) != size):
            self._fail(node, f"'{self._path(key)}' is {_show(_construct(node))}, expected {wanted}")
        return np.array([self._as_number(n, key) for n in node.value], dtype=float)

    def texts(self, key: str, default: Any = REQUIRED, choices: tuple[str, ...] = ()) -> list[str]:
        node = self._take(key, default is not REQUIRED, "a list of texts")
        if node is None:
            return list(default)
        values = _construct(node)
        if not isinstance(values, list) or not all(isinstance(v, str) for v in values):
            self._fail(node, f"'{self._path(key)}' is {_show(values)}, expected a list of texts")
        for value in values:
            if choices and value not in choices:
                self._fail(node, f"'{self._path(key)}' has '{value}', expected {', '.join(choices)}")
            if values.count(value) > 1:
                self._fail(node, f"'{self._path(key)}' names '{value}' twice")
        return [str(v) for v in values]

    def plain(self, key: str, default: Any = REQUIRED) -> Any:
        """Whatever stands there, for options that are passed on unseen."""
        node = self._take(key, default is not REQUIRED, "a value")
        return default if node is None else _construct(node)

    def section(self, key: str, optional: bool = False) -> Section | None:
        node = self._take(key, optional, "a mapping")
        return None if node is None else self._as_section(node, self._path(key))

    def need(self, key: str) -> Section:
        """A mapping that must be there."""
        found = self.section(key)
        assert found is not None
        return found

    def sections(self, key: str, optional: bool = False) -> list[Section]:
        node = self._take(key, optional, "a list")
        if node is None:
            return []
        if not isinstance(node, yaml.SequenceNode):
            self._fail(node, f"'{self._path(key)}' is {_show(_construct(node))}, expected a list")
        return [self._as_section(n, f"{self._path(key)}[{k}]") for k, n in enumerate(node.value)]

    def fail(self, message: str, key: str | None = None) -> NoReturn:
        """Raise this file's error, naming file and line."""
        node = self._nodes.get(key) if key else None
        line = node.start_mark.line + 1 if node is not None else self.line
        raise self._error(f"{self._file}:{line}: {message}")

    def path(self, key: str) -> str:
        return self._path(key)

    # --- inside --------------------------------------------------------------------------------------------
    def _path(self, key: str) -> str:
        return f"{self._where}.{key}" if self._where else key

    def _fail(self, node: yaml.Node, message: str) -> NoReturn:
        raise self._error(f"{self._file}:{node.start_mark.line + 1}: {message}")

    def _take(self, key: str, optional: bool, wanted: str) -> yaml.Node | None:
        self._read.add(key)
        node = self._nodes.get(key)
        if node is not None and not (optional and node.tag == NOTHING):
            return node
        if not optional:
            self.fail(f"missing key '{self._path(key)}' (expected {wanted})")
        return None

    def _as_section(self, node: yaml.Node, where: str) -> Section:
        if not isinstance(node, yaml.MappingNode):
            self._fail(node, f"'{where}' is {_show(_construct(node))}, expected a mapping")
        return Section(node, self._file, where, self._error)

    def _refuse_other_bases(self, node: yaml.Node, key: str) -> None:
        """YAML 1.1 reads 012 as ten, 1:30 as ninety and 1_000 as a thousand."""
        if isinstance(node, yaml.ScalarNode) and node.tag in NUMBERS and OTHER_BASE.search(node.value):
            read = f"{node.value[:60]}, which YAML reads as {_show(_construct(node))}"
            self._fail(node, f"'{self._path(key)}' has {read}, expected a plain number")

    def _as_number(self, node: yaml.Node, key: str) -> float:
        self._refuse_other_bases(node, key)
        value = _construct(node)
        if isinstance(value, str):  # YAML 1.1 reads 2e-5 as a text
            try:
                value = float(value)
            except ValueError:
                self._fail(node, f"'{self._path(key)}' has {_show(value)}, expected a number")
        if not isinstance(value, int | float) or isinstance(value, bool):
            self._fail(node, f"'{self._path(key)}' has {_show(value)}, expected a number")
        if not abs(value) <= LARGEST:
            self._fail(node, f"'{self._path(key)}' has {_show(value)}, expected a finite number")
        return float(value)


def read_yaml(path: Path | str, error: type[BadInput]) -> Section:
    """The file's top-level mapping. Raises `error` when it is missing, empty, not YAML or not a mapping."""
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise error(f"{path}: no such file") from None
    except IsADirectoryError:
        raise error(f"{path}: a folder, expected a file") from None
    except (OSError, UnicodeDecodeError) as exc:
        raise error(f"{path}: cannot be read as UTF-8 text ({_one_line(exc)})") from None
    try:
        node = yaml.compose(unicodedata.normalize("NFC", text), Loader=yaml.SafeLoader)
    except yaml.YAMLError as exc:
        raise error(f"{path}: not valid YAML ({_one_line(exc)})") from None
    except RecursionError:
        raise error(f"{path}: not valid YAML (nested too deep)") from None
    if node is None:
        raise error(f"{path}: the file is empty")
    if not isinstance(node, yaml.MappingNode):
        raise error(f"{path}:1: expected a mapping at the top, found {_show(_construct(node))}")
    return Section(node, path, "", error)


def _construct(node: yaml.Node) -> Any:
    """What the node stands for; what YAML itself cannot make of it (a month 13, a loop) comes back as its bare text."""
    loader = yaml.SafeLoader("")
    try:
        return loader.construct_object(node, deep=True)
    except (yaml.YAMLError, ValueError, TypeError, LookupError, AttributeError, OverflowError, RecursionError):
        return node.value if isinstance(node, yaml.ScalarNode) else "something that YAML cannot read"


def _show(value: Any) -> str:
    if isinstance(value, int) and abs(value) > LARGEST:
        return "a huge number"  # Python refuses to write integers of more than 4300 digits
    text = "nothing" if value is None else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _range(low: float, high: float) -> str:
    if math.isinf(high):
        return f"at least {low:g}"
    return f"between {low:g} and {high:g}"


def _one_line(exc: Exception) -> str:
    return " ".join(str(exc).split())
