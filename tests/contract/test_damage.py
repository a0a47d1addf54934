"""Everything that nobody thought of: however a file is damaged, a command does its work or says in one line why not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.contract.desk import lay_out, one_line, ppshw

# Some of what is written here was found by 1,500 examples of each; these few keep it so.
FEW = settings(max_examples=40, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))


@st.composite
def damage(draw: st.DrawFn) -> Callable[[bytes], bytes]:
    """A few bytes flipped, a piece taken out or doubled, or the end cut off."""
    kind = draw(st.sampled_from(["flip", "flip", "cut", "out", "double"]))
    at, size = draw(st.floats(0, 1, exclude_max=True)), draw(st.integers(1, 60))
    places = draw(st.lists(st.floats(0, 1, exclude_max=True), min_size=1, max_size=4))
    values = draw(st.lists(st.integers(1, 255), min_size=4, max_size=4))
    digits = draw(st.booleans())

    def apply(data: bytes) -> bytes:
        k = int(at * len(data))
        if kind == "cut":
            return data[:k]
        if kind == "out":
            return data[:k] + data[k + size :]
        if kind == "double":
            return data[:k] + data[k : k + size] + data[k:]
        out = bytearray(data)
        for place, value in zip(places, values, strict=False):
            p = int(place * len(data))
            out[p] = b"0123456789eE.-+, \n:"[value % 19] if digits else out[p] ^ value
        return bytes(out)

    return apply


@pytest.fixture(scope="module")
def fuzzed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return lay_out(tmp_path_factory.mktemp("fuzzed"))


def survives(folder: Path, name: str, change: Callable[[bytes], bytes], *commands: list[str]) -> None:
    """Damaged or not: a command does what it should or says in one line why not."""
    good = (folder / name).read_bytes()
    try:
        (folder / name).write_bytes(change(good))
        for words in commands:
            said = ppshw(*(w.replace("@", f"{folder}/") for w in words))
            assert said.code in (0, 1, 2)
            warned = [line for line in said.err.splitlines(keepends=True) if line.startswith("warning: ")]
            beside = said.err.removeprefix("".join(warned))  # of a column that is nearly called like one that is lost
            assert beside == "" if said.code == 0 else one_line(beside)
            for made in ("new.db", "new.json"):
                (folder / made).unlink(missing_ok=True)
            assert not list(folder.glob("*.part"))
    finally:
        (folder / name).write_bytes(good)


@FEW
@given(damage())
def test_no_damage_to_a_machine_file_is_a_surprise(fuzzed: Path, change: Callable[[bytes], bytes]) -> None:
    evaluate = ["evaluate", "@good.csv", "--machine", "@machine.yaml"]
    survives(fuzzed, "machine.yaml", change, ["plan", "@little.yaml", "--machine", "@machine.yaml"], evaluate)


@FEW
@given(damage())
def test_no_damage_to_a_table_is_a_surprise(fuzzed: Path, change: Callable[[bytes], bytes]) -> None:
    calibrated = ["evaluate", "@good.csv", "--machine", "@machine.yaml", "--calibration", "@cal.json"]
    survives(fuzzed, "good.csv", change, ["import", "@good.csv", "--machine", "@machine.yaml", "--out", "@new.db"],
             calibrated)  # fmt: skip


@FEW
@given(damage())
def test_no_damage_to_a_recording_is_a_surprise(fuzzed: Path, change: Callable[[bytes], bytes]) -> None:
    survives(fuzzed, "good.db", change, ["evaluate", "@good.db", "--machine", "@machine.yaml"])


@FEW
@given(damage())
def test_no_damage_to_a_calibration_is_a_surprise(fuzzed: Path, change: Callable[[bytes], bytes]) -> None:
    given_ = ["--machine", "@machine.yaml", "--calibration", "@cal.json"]
    survives(fuzzed, "cal.json", change, ["compensate", *given_, "--joints", "0.1 0.2"])


@FEW
@given(damage())
def test_no_damage_to_a_campaign_is_a_surprise(fuzzed: Path, change: Callable[[bytes], bytes]) -> None:
    survives(fuzzed, "little.yaml", change, ["plan", "@little.yaml", "--machine", "@machine.yaml"])


@FEW
@given(damage())
def test_no_damage_to_a_site_is_a_surprise(fuzzed: Path, change: Callable[[bytes], bytes]) -> None:
    # a recording of another campaign stands in the way: the site is read, and nothing is ever connected
    survives(fuzzed, "site.yaml", change, ["run", "@little.yaml", "--site", "@site.yaml", "--out", "@good.db"])


@settings(FEW, max_examples=15)
@given(damage())
def test_no_damage_to_a_table_surprises_the_identification(fuzzed: Path, change: Callable[[bytes], bytes]) -> None:
    identify = ["identify", "@good.csv", "--machine", "@machine.yaml", "--out", "@new.json"]
    survives(fuzzed, "good.csv", change, identify)
