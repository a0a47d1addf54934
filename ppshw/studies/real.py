"""Study: what the model misses on recordings of real machines, cross-validated, and from one floor to another.

    python -m ppshw.studies.real [--short] [--only hilti|ur10|ur5] [--data DIR] [--out DIR]

Writes real.json, real.md and real.svg. The recordings are their publishers' (docs/real-data.md); without them: exit 2.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.calibration import Calibration
from ppshw.converters import hilti, ur5, ur10
from ppshw.errors import BadInput, PpshwError
from ppshw.evaluation import residuals
from ppshw.identification.joint import estimate
from ppshw.identification.start import align, to_base
from ppshw.identification.structure import joint_model
from ppshw.kinematics import point_positions
from ppshw.machine import Machine, load_machine
from ppshw.model import Model
from ppshw.progress import Bar
from ppshw.recording import Recording, load_recording
from ppshw.studies.folds import FOLDS, Fit, Labels, Residuals, Score, blocks, cross_validate, grouped, shuffled
from ppshw.studies.measured_tilt import MeasuredTilt
from ppshw.studies.real_tables import Check, Row, draw, markdown
from ppshw.studies.stationing import across, identify_leaning
from ppshw.terms import Situation
from ppshw.terms.basis import Constant, Smooth
from ppshw.whole_file import write_text

Array = NDArray[np.float64]
TOP = Path(__file__).resolve().parents[2]
FILES = {
    "hilti flat": ("hilti", hilti.convert, "hilti/flat.yaml"),
    "hilti pallet": ("hilti", hilti.convert, "hilti/pallet.yaml"),
    "hilti orthogonal_wood": ("hilti", hilti.convert, "hilti/orthogonal_wood.yaml"),
    "ur10 B": ("ur10", ur10.convert, "ur10/series_b.csv"),
    "ur10 C": ("ur10", ur10.convert, "ur10/series_c.csv"),
    "ur5 grid": ("ur5", ur5.convert, "ur5/grid.csv"),
    "ur5 random": ("ur5", ur5.convert, "ur5/random.csv"),
}
Structure = Callable[[Machine, Recording], Model]


# --- models --------------------------------------------------------------------------------------------------------
def nominal(machine: Machine, known: Recording) -> Residuals:
    """The ideal machine; measuring frame and target from the visits that may be known."""
    frame, targets = align(machine, known, targets_free=not machine.tracker.targets_known)
    return lambda r: np.asarray(to_base(r.points, frame) - point_positions(machine, r.q, targets))


def fitted(structure: Structure) -> Fit:
    def fit(machine: Machine, known: Recording) -> Residuals:
        calibration = identified(structure, machine, known)
        return lambda r: residuals(r, calibration)

    return fit


def identified(structure: Structure, machine: Machine, known: Recording) -> Calibration:
    return Calibration.of(estimate(structure(machine, known), known), known, "joint")


def straight_lines(machine: Machine, known: Recording) -> Model:
    """Every generalized error a straight line in its joint's position; elastic terms as always."""
    return joint_model(machine, known, waves=0)


def smooth(machine: Machine, known: Recording) -> Model:
    """The joint estimate without the fine waves of the joints' own motion."""
    model = joint_model(machine, known)
    return replace(model, terms=tuple(t for t in model.terms if t.kind != "own_motion"))


def with_tilts(machine: Machine, known: Recording) -> Model:
    """The joint estimate and the Hilti column's two tilt sensors: how its base leans, how its tip leans against it."""
    model = joint_model(machine, known)
    low, high = float(known.q[:, 0].min()), float(known.q[:, 0].max())
    base, tip = ("tilt_base_x", "tilt_base_y"), ("tilt_tip_x", "tilt_tip_y")
    line = Smooth((low + high) / 2, (high - low) / 2, 0)
    rocking = MeasuredTilt.of(0, base, ("", ""), Constant(), known)
    bending = MeasuredTilt.of(1, tip, base, line, known)
    return replace(model, terms=(*model.terms, rocking, bending))


# --- the study -----------------------------------------------------------------------------------------------------
@dataclass
class Study:
    """What is to be done, and what came out: rows of the table, checks against the bars, residuals for the picture."""

    data: Path
    short: bool
    only: str
    bar: Bar
    rows: list[Row] = field(default_factory=list)
    checks: list[Check] = field(default_factory=list)
    residuals: dict[tuple[str, str], Array] = field(default_factory=dict)
    loaded: dict[str, tuple[Machine, Recording]] = field(default_factory=dict)

    def load(self) -> None:
        """Convert and read every recording before the first fit. Raises BadInput when one is absent."""
        wanted = {name: file for name, file in FILES.items() if name.startswith(self.only)}
        for _, _, source in wanted.values():
            if not (self.data / source).is_file():
                raise BadInput(f"{self.data / source}: no such recording; --data or PPSHW_DATA says where they are")
        with tempfile.TemporaryDirectory() as folder:
            for k, (name, (machine_name, convert, source)) in enumerate(wanted.items()):
                self.bar("reading recordings", k, len(wanted))
                machine = load_machine(TOP / "machines" / "real" / f"{machine_name}.yaml")
                out = Path(folder) / f"{name}.csv"
                convert(self.data / source, out)
                self.loaded[name] = machine, load_recording(out, machine)

    def validate(self, name: str, label: str, fit: Fit, folds: dict[str, Labels]) -> None:
        machine, recording = self.loaded[name]
        for k, (how, held) in enumerate(folds.items()):
            if self.short and how != "blocks":
                continue
            self.bar(f"{name}, {label}", k, len(folds))
            score = cross_validate(machine, recording, fit, held, at_most=1 if self.short else FOLDS)
            self.add(name, label, how, score)
            if how == "blocks":
                self.residuals[name, label] = score.residuals

    def add(self, name: str, label: str, how: str, score: Score) -> dict[str, float]:
        figures = score.figures()
        self.rows.append(Row(name, label, how, figures, score.seconds, score.cpu_seconds))
        return figures

    def figure(self, name: str, label: str, how: str, key: str) -> float:
        return next(r.figures[key] for r in self.rows if (r.data, r.model, r.held_out) == (name, label, how))

    def check(self, what: str, least: float, bar: float, value: float) -> None:
        self.checks.append(Check(what, least, bar, value))


def hilti_flat(study: Study) -> None:
    _, recording = study.loaded["hilti flat"]
    folds = {
        "shuffled": shuffled(len(recording)),
        "blocks": blocks(len(recording)),
        "stations": grouped([s.partition(":")[0] for s in recording.step]),
        "heights": grouped([s.partition("_")[0] for s in recording.step]),
    }
    study.validate("hilti flat", "nominal", nominal, folds)
    study.validate("hilti flat", "straight lines", fitted(straight_lines), folds)
    study.validate("hilti flat", "joint", fitted(joint_model), folds)
    study.validate("hilti flat", "joint + tilts", fitted(with_tilts), folds)
    value = study.figure("hilti flat", "joint", "blocks", "rms_mm")
    study.check("Hilti flat, without tilts, blocks, RMS", 2.0, 1.6, value)


def hilti_across(study: Study) -> None:
    """Model from `flat` alone; base refitted per station on stationing poses; evaluation poses scored."""
    machine, flat = study.loaded["hilti flat"]
    _, targets = align(machine, flat, targets_free=True)
    ideal = Model(machine.with_targets(dict(zip(machine.targets, targets, strict=True))), ())
    variants: list[tuple[str, Model, Array, bool]] = [("nominal", ideal, np.zeros(0), False)]
    for label, structure in (("straight lines", straight_lines), ("joint", joint_model)):
        study.bar("hilti, from floor to floor", len(variants), 5)
        made = identified(structure, machine, flat)
        variants.append((label, made.model, made.theta, False))
    study.bar("hilti, from floor to floor", 3, 5)
    leaning = identify_leaning(machine, flat)
    variants.append(("joint, gravity follows the base", leaning.model, leaning.theta, True))
    study.bar("hilti, from floor to floor", 4, 5)
    tilts = identified(with_tilts, leaning.machine, flat)
    variants.append(("joint + tilts, gravity follows the base", tilts.model, tilts.theta, True))
    for name in ("hilti pallet", "hilti orthogonal_wood"):
        recording = study.loaded[name][1]
        for label, model, theta, follow in variants:
            score = Score(across(model, theta, recording, follow))
            figures = study.add(name, label, "other floor", score)
            study.residuals[name, label] = score.residuals
            if label.startswith("joint, "):
                study.check(f"Hilti {name.partition(' ')[2]}, model from flat, mean", np.inf, 2.3, figures["mean_mm"])


def ur10_series(study: Study, name: str) -> None:
    folds = {"shuffled": shuffled(len(study.loaded[name][1])), "blocks": blocks(len(study.loaded[name][1]))}
    study.validate(name, "nominal", nominal, folds)
    study.validate(name, "straight lines", fitted(straight_lines), folds)
    study.validate(name, "joint, no fine waves", fitted(smooth), folds)
    study.validate(name, "joint", fitted(joint_model), folds)
    if name == "ur10 C":
        study.check("UR10 C, blocks, RMS", 0.49, 0.12, study.figure(name, "joint", "blocks", "rms_mm"))


def ur5_grid_and_test(study: Study) -> None:
    machine, grid = study.loaded["ur5 grid"]
    test = study.loaded["ur5 random"][1]
    folds = {"shuffled": shuffled(len(grid)), "blocks": blocks(len(grid))}
    models: dict[str, Fit] = {
        "nominal": nominal,
        "straight lines": fitted(straight_lines),
        "joint": fitted(joint_model),
    }
    for label, fit in models.items():
        study.validate("ur5 grid", label, fit, folds)
        began, busy = time.perf_counter(), time.process_time()
        missing = fit(machine, grid)
        score = Score(missing(test), time.perf_counter() - began, time.process_time() - busy)
        figures = study.add("ur5 random", label, "other poses", score)
        study.residuals["ur5 random", label] = score.residuals
    study.check("UR5 test, mean", 0.105, 0.100, figures["mean_mm"])
    lines = study.figure("ur5 random", "straight lines", "other poses", "mean_mm")
    study.check("UR5 test with straight lines alone, mean", 0.105, 0.100, lines)


def run(data: Path, short: bool, only: str, bar: Bar) -> Study:
    """only: "hilti", "ur10", "ur5" or "" for everything."""
    study = Study(data, short, only, bar)
    study.load()
    if only in ("", "hilti"):
        hilti_flat(study)
        hilti_across(study)
    if only in ("", "ur5"):
        ur5_grid_and_test(study)
    if only in ("", "ur10"):
        for name in ("ur10 C",) if short else ("ur10 C", "ur10 B"):
            ur10_series(study, name)
    return study


def own_motions(study: Study) -> list[tuple[str, Array, Array]]:
    """What the UR10's first three joints do about their own axes beyond a straight line: name, q and error [rad]."""
    if "ur10 C" not in study.loaded:
        return []
    machine, recording = study.loaded["ur10 C"]
    calibration = identified(joint_model, machine, recording)
    count = 600
    q = np.linspace(calibration.joint_range[:, 0], calibration.joint_range[:, 1], count)
    situation, unloaded = Situation(q, np.zeros((count, 6))), np.zeros((count, machine.n + 1, 6))
    about = np.zeros((3, count))
    at = 0
    for term in calibration.model.terms:
        size = len(term.parameters(machine.frame_names))
        if 1 <= term.frame <= 3 and term.kind in ("geometric", "own_motion"):
            turn = term.regressors(situation, unloaded)[:, 3:] @ calibration.theta[at : at + size]
            about[term.frame - 1] += turn @ machine.joints[term.frame - 1].axis
        at += size
    lines = [np.polyval(np.polyfit(q[:, k], about[k], 1), q[:, k]) for k in range(3)]
    return [(machine.joint_names[k], q[:, k], about[k] - lines[k]) for k in range(3)]


def main(argv: Sequence[str] | None = None) -> int:
    default = Path(os.environ.get("PPSHW_DATA", TOP.parent / "shared" / "data"))
    parser = argparse.ArgumentParser(prog="python -m ppshw.studies.real", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, default=default, help="where the recordings are (or PPSHW_DATA)")
    parser.add_argument("--out", type=Path, default=Path("real-study"), help="folder for real.json, real.md, real.svg")
    parser.add_argument("--short", action="store_true", help="blocks only, one fold of five, no series B: a minute")
    parser.add_argument("--only", default="", choices=("hilti", "ur10", "ur5"), help="one machine instead of all three")
    args = parser.parse_args(argv)
    began = time.perf_counter()
    try:
        with Bar() as bar:
            study = run(args.data, args.short, args.only, bar)
            motions = own_motions(study)
    except PpshwError as exc:
        print(exc, file=sys.stderr)
        return exc.exit_code
    args.out.mkdir(parents=True, exist_ok=True)
    answer: dict[str, Any] = {
        "short": args.short,
        "rows": [row.as_dict() for row in study.rows],
        "checks": [check.as_dict() for check in study.checks],
        "seconds": round(time.perf_counter() - began, 1),
    }
    write_text(args.out / "real.json", json.dumps(answer, indent=1))
    text = markdown(study.rows, study.checks, args.short)
    write_text(args.out / "real.md", text)
    draw(study.residuals, motions, args.out / "real.svg")
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
