"""A machine with nothing wrong beyond the model, and what was measured on it."""

from __future__ import annotations

from pathlib import Path

from ppshw.machine import Machine, load_machine
from ppshw.recording import Recording, load_recording
from simulators.concealed.case import make_case


def clean_case(seed: int, machine: str, visits: int, fit: int, folder: Path) -> tuple[Machine, Recording]:
    """Of `machine` ("pps" or "arm6"), the first `fit` of so many visits; files go into the folder."""
    make_case(seed, machine, "null", 0.0, folder / "case", folder / "sealed", visits, fit)
    loaded = load_machine(folder / "case" / "machine.yaml")
    return loaded, load_recording(folder / "case" / "recording.csv", loaded)
