"""The machine hides something: found, named, modelled and, where it can be, taken out; then the seal is opened.

The simulated machine carries an effect that a seed picks and nothing prints; the SHA-256 of what it is, salted, is
written before anything moves. The diagnosis campaign runs through the drivers, the diagnosis says what it finds, and
the tracker measures the verification poses three times: with nominal setpoints, with those of the base calibration, and
with those of the calibration that the findings extend. Only then is the truth written down and compared.
"""

from __future__ import annotations

import json
import secrets
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from campaigns.plan import Plan, plan_campaign
from campaigns.script import load_script
from campaigns.site import load_site
from ppshw.calibration import Calibration
from ppshw.compensation import Bounds, Compensator, Corrections
from ppshw.demo import POINT, SimulatedSite, as_wanted, fresh_folder
from ppshw.diagnosis import diagnose
from ppshw.diagnosis.modelled import extended
from ppshw.diagnosis.wording import how_sure
from ppshw.errors import BadInput
from ppshw.evaluation import figures
from ppshw.identification import identify
from ppshw.kinematics import point_positions
from ppshw.machine import load_machine
from ppshw.progress import folded
from ppshw.recording import Recording
from ppshw.report.concealed import hidden, named, treated
from ppshw.terms.effect import instrument_error
from ppshw.verification import point_errors, wanted_joints
from ppshw.whole_file import file_hash, write_text
from simulators.clock import SteppedClock
from simulators.hardware import SimulatedHardware, ToConceal

Array = NDArray[np.float64]
Say = Callable[[str, int, int], None]
CAMPAIGNS = {"diagnosis": "diagnosis", "verification": "verification"}
ROWS = ("nominal", "base", "extended")
# A sensor that errs by as much as shows at the reflectors reads other loads than were identified: on site that is a
# reason to stop, here to go on and see.
BOUNDS = Bounds(loads=1.0)


def run_concealed(
    out: Path,
    conceal: int,
    seed: int,
    machine_file: Path,
    say: Say,
    announce: Callable[[str], None] = lambda seal: None,
    campaigns: Mapping[str, str] = CAMPAIGNS,
    salt: str | None = None,
    size: float = 2.0,
    effect: str | None = None,
) -> dict[str, Any]:
    """Run it into the folder `out` and return the answer, which `concealed.json` holds too.

    conceal   seed of the effect;  seed: of the machine
    announce  is told the seal before anything moves
    salt      None: from the system's randomness, so that nobody can hash his way through all effects
    size      of the effect, rms at the reflectors in units of the repeatability's there
    effect    None: the seed picks one
    """
    started = time.perf_counter()
    machine = load_machine(machine_file)
    if POINT not in machine.points:
        raise BadInput(f"{machine_file}: the demo needs a point named '{POINT}' in tip.points")
    plans = {name: plan_campaign(load_script(script), machine) for name, script in campaigns.items()}
    hidden = ToConceal(conceal, _hours(plans["diagnosis"]), salt or secrets.token_hex(16), size, effect)
    with fresh_folder(out, machine_file) as machine_copy:
        machine = load_machine(machine_copy)
        clock = SteppedClock()
        with SimulatedHardware(machine_copy, clock, out, seed=seed, concealed=hidden) as hardware:
            assert hardware.carried is not None
            (out / "seal.sha256").write_text(hardware.carried.seal + "\n", encoding="utf-8")
            announce(hardware.carried.seal)
            site = load_site(hardware.write_site(out / "site.yaml"))
            bench = SimulatedSite(out, machine, site, hardware, clock, say, load_changes_take_time=True)
            recording = bench.measure("diagnosis", campaigns["diagnosis"])
            base = Calibration.of(identify(machine, recording), recording, "joint")
            base.save(out / "calibration.json")
            began = time.perf_counter()
            found = diagnose(machine, recording, progress=lambda k, n: say("diagnose", k, n))
            diagnose_s = time.perf_counter() - began
            write_text(out / "diagnosis.json", json.dumps(found.answer, indent=1))
            more = extended(found.space, found.found, found.answer["findings"])
            more.save(out / "extended.json")
            recordings, corrected = _verified(bench, campaigns["verification"], base, more)
            (out / "truth.json").write_bytes(hardware.carried.truth)
        answer: dict[str, Any] = {
            "seal": hardware.carried.seal,
            "conceal": conceal,
            "seed": seed,
            **{key: found.answer[key] for key in ("verdict", "findings", "unexplained", "held_out")},
            **_compared(json.loads(hardware.carried.truth), found.answer["findings"]),
            **_at_the_point(recordings, more),
            "taken_out": corrected.as_dicts(True),
            "not_compensated": corrected.as_dicts(False),
            "visits": len(recording),
            "verification_visits": len(recordings["nominal"]),
            "diagnose_seconds": round(diagnose_s, 1),
            "machine_hours": round(clock.now() / 3600, 1),
            "seconds": round(time.perf_counter() - started, 1),
        }
        write_text(out / "concealed.json", json.dumps(answer, indent=1))
        return answer


def _hours(plan: Plan) -> float:
    """How long a campaign takes on simulated hardware, whose shots take no time."""
    summary = plan.summary()
    return (summary.duration_s - plan.script.measure_s * summary.readings) / 3600.0


def _verified(
    bench: SimulatedSite, script: str, base: Calibration, more: Calibration
) -> tuple[dict[str, Recording], Corrections]:
    """Row → what the tracker measured with the setpoints of no calibration, the base one and the extended one; and how
    the last one corrected."""
    nominal = bench.measure("verification_nominal", script, as_wanted, "nominal")
    label = file_hash(bench.out / "calibration.json")
    by_base = bench.measure("verification_base", script, Corrections(Compensator(base, BOUNDS)), label)
    corrected = Corrections(Compensator(more, BOUNDS), after=by_base)
    by_more = bench.measure("verification_extended", script, corrected, file_hash(bench.out / "extended.json"))
    return dict(zip(ROWS, (nominal, by_base, by_more), strict=True)), corrected


def _at_the_point(recordings: Mapping[str, Recording], more: Calibration) -> dict[str, Any]:
    """Figures of every row, and of readings corrected for what the instrument is found to err where it is."""
    errors = {row: point_errors(r, more.machine, POINT) for row, r in recordings.items()}
    instrument = {row: _without_instrument(more, r, errors[row]) for row, r in recordings.items()}
    return {
        **{row: figures(e) for row, e in errors.items()},
        "instrument_corrected": {row: figures(e) for row, e in instrument.items() if e is not None},
    }


def _compared(truth: Mapping[str, Any], findings: list[dict[str, Any]]) -> dict[str, Any]:
    """The truth, and  named: a finding has the effect's name;  joint_right: and the right joint, None where it was not
    named;  false_findings: how many others there are."""
    mine = [f for f in findings if f["effect"] == truth["effect"]]
    joints = [truth["joint"], *truth["also"]]
    return {
        "truth": truth,
        "named": bool(mine),
        "joint_right": any(f["joint"] in joints for f in mine) if mine else None,
        "false_findings": len(findings) - len(mine),
    }


def _without_instrument(calibration: Calibration, recording: Recording, errors: Array) -> Array | None:
    """Errors (N, 3) at the point without what the instrument is found to err; None where it is not found to."""
    machine = calibration.machine
    ideal = point_positions(machine, wanted_joints(recording), machine.point(POINT)[None])[:, 0]
    erring = instrument_error(
        calibration.effects, calibration.model, calibration.laid_at, recording, calibration.measuring_in_base,
        calibration.reference, ideal + np.nan_to_num(errors),
    )  # fmt: skip
    return errors - erring if erring.any() else None


def sentences(answer: Mapping[str, Any], figures_table: list[str]) -> list[str]:
    """The answer in words, lines of at most 80 letters.

    figures_table  head and rows of the figures at the treatment point
    """
    truth, found = answer["truth"], answer["findings"]
    lines = ["found"]
    lines += [f"{f['sentence']} {how_sure(f)}" for f in found]
    if answer["unexplained"] is not None:
        lines.append(f"structure over {' and '.join(answer['unexplained']['covariates'])} that nothing known explains")
    if len(lines) == 1:
        lines.append("nothing")
    lines += ["the seal is opened", hidden(truth), "   ".join(named(answer)), *treated(answer)]
    seen = f"at the treatment point, {answer['verification_visits']} configurations that no fit has seen [mm]"
    if answer["instrument_corrected"]:
        lines.append("* readings corrected for what the instrument is found to err")
    head = [f"seal {answer['seal']}"]
    return [*head, *folded(lines).splitlines(), seen, *figures_table]


def table_rows(answer: Mapping[str, Any]) -> dict[str, dict[str, float]]:
    """Name → figures of every row worth showing; readings corrected where the instrument was found to err."""
    rows = {name: answer[key] for key, name in zip(ROWS, ("nominal", "base calibration", "with findings"), strict=True)}
    corrected = answer["instrument_corrected"]
    if corrected:
        rows |= {"base, corr.*": corrected["base"], "findings, corr.*": corrected["extended"]}
    return rows
