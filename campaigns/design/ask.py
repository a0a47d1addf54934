"""`ppshw plan --visits`, `--accuracy`, `--after`: a question, and its answer in numbers and in words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from campaigns.design.belief import Belief, learnt, typical
from campaigns.design.designer import LOAD_CASES, Design, Designer, Progress, Request, loads_for
from campaigns.design.loads import measured_with
from campaigns.design.sequential import known_from
from campaigns.design.write import script_text
from campaigns.plan import Plan, plan_campaign
from campaigns.script import EMPTY, Script, load_script
from ppshw.calibration import Calibration
from ppshw.errors import CampaignError
from ppshw.identification import identify
from ppshw.identification.joint import Estimate
from ppshw.machine import Machine
from ppshw.quantities import many
from ppshw.recording import Recording
from ppshw.whole_file import write_text

# A model is made for about this many visits where the number is what is asked for.
ABOUT = 300
# What is measured next when nobody says how much: two rounds.
NEXT = 30
# When so many more visits lower the 98.6 % by less than this share, measuring on is hardly worth its time.
HARDLY = 0.02


@dataclass(frozen=True)
class Question:
    """visits, accuracy [m]: one of them, or neither after a recording; loads: a script whose load cases are there to be
    put on, None: those of the recording, or what is usual; point: where accuracy counts, default `where_it_counts`;
    estimate: of the recording."""

    machine: Machine
    visits: int | None
    accuracy: float | None
    after: Recording | None
    calibration: Calibration | None
    loads: Script | None
    load_cases: int | None
    point: str | None
    seed: int
    name: str
    asked: str
    estimate: Estimate | None = None


@dataclass(frozen=True)
class Answer:
    """numbers for programs, lines for people; plan None: nothing needs to be measured, nothing was written."""

    numbers: dict[str, Any]
    lines: list[str]
    plan: Plan | None


def answer(question: Question, out: Path, progress: Callable[[str], Progress] | None = None) -> Answer:
    """Design the campaign and write its script to `out`. Raises CampaignError with one line of what cannot be done.

    progress  for a stage's name, who is to be told of its steps
    """
    progress = progress or (lambda stage: lambda done, total: None)
    machine, recording = question.machine, question.after
    point = question.point or machine.where_it_counts
    place = machine.point(point)
    about = question.visits or (ABOUT if recording is None else len(recording) // 2)
    information = None
    if recording is not None:
        estimate = question.estimate or identify(machine, recording, progress=progress("identify"))
        known = known_from(recording, estimate, about)
        belief, information = known.belief, known.information
    else:
        belief = _belief(question, about)
    few = question.load_cases or LOAD_CASES
    given = list(question.loads.loads) if question.loads else None
    if given is None and recording is not None and (found := measured_with(recording, machine)):
        given = [EMPTY, *found]
    # after a recording any load may be the missing one; before, the most telling few are known beforehand
    work, cases = loads_for(machine, place, given, few if recording is None else None)
    designer = Designer(Request(belief, point, work, cases, few, question.seed, information))
    numbers: dict[str, Any] = {"point": point, "noise_p98_6_mm": 1e3 * designer.floor}
    low, high = work.mass
    whose = "as usual" if given is None else f"as in {question.loads.name if question.loads else 'the recording'}"
    lines = [f"for loads of {low:.0f} to {high:.0f} kg, {whose}"] if high else []
    if recording is not None:
        more = _now(question, designer, numbers, lines)
        if more == 0:
            return Answer(numbers, lines, None)
    elif question.accuracy is not None:
        lines.append(f"asked for: 98.6 % within {1e3 * question.accuracy:.3g} mm")
    design = (
        designer.design(question.visits or NEXT, progress("design"))
        if question.accuracy is None
        else designer.design_for(question.accuracy, progress("design"))
    )
    write_text(out, script_text(design, question.name, question.asked))
    plan = plan_campaign(load_script(out), machine)
    _design(design, plan, numbers, lines)
    return Answer(numbers, lines, plan)


def _belief(question: Question, visits: int) -> Belief:
    machine, calibration = question.machine, question.calibration
    if calibration is None:
        point = question.point or machine.where_it_counts
        return typical(machine, visits, machine.point(point))
    if not calibration.strengths:
        raise CampaignError(
            f"--calibration: made by method '{calibration.provenance['method']}' or an earlier version, which kept no "
            "prior strengths; identify the recording again with --method joint"
        )
    origin = f"what calibration {calibration.provenance['recording_sha256'][:12]} learnt"
    return learnt(calibration.machine, visits, calibration.strengths, calibration.noise, origin)


def _now(question: Question, designer: Designer, numbers: dict[str, Any], lines: list[str]) -> int | None:
    """What is known after the recording; how many visits are missing (0: enough), None where no accuracy was asked."""
    recording = question.after
    assert recording is not None
    model, both = designer.posterior().accuracy()
    visits = int(recording.measured.sum())
    numbers["now"] = {"visits": visits, "model_p98_6_mm": 1e3 * model, "with_noise_p98_6_mm": 1e3 * both}
    lines.append(
        f"after {many(visits, 'visit')}: 98.6 % at {designer.request.point} predicted {1e3 * both:.3f} mm "
        f"with noise, {1e3 * model:.3f} mm of the model ({1e3 * designer.floor:.3f} mm of noise alone)"
    )
    if question.accuracy is None:
        return None
    more = designer.visits_for(question.accuracy)
    numbers["enough"], numbers["expected_visits"] = more == 0, more
    wanted = f"{1e3 * question.accuracy:.3g} mm"
    lines.append(f"enough: {wanted} is reached; stop" if more == 0 else f"not enough for {wanted}: about {more} more")
    return more


def _design(design: Design, plan: Plan, numbers: dict[str, Any], lines: list[str]) -> None:
    summary = plan.summary()
    model, both = design.accuracy
    numbers |= summary.as_dict() | {
        "predicted": {"model_p98_6_mm": 1e3 * model, "with_noise_p98_6_mm": 1e3 * both},
        "travel_s": design.travel_s,
        "travel_bound_s": design.bound_s,
    }
    lines.append(
        f"98.6 % at {design.request.point} predicted {1e3 * both:.3f} mm with noise, {1e3 * model:.3f} mm of the model "
        f"({1e3 * design.floor:.3f} mm of noise alone), as believed of {design.request.belief.origin}"
    )
    over = 100 * (design.travel_s / design.bound_s - 1) if design.bound_s else 0.0
    lines.append(f"travel {design.travel_s:.0f} s, {over:.1f} % above the lower bound of {design.bound_s:.0f} s")
    if "now" in numbers and (gain := 1 - both / design.before[1]) < HARDLY:
        lines.append(f"these visits lower it by {100 * gain:.1f} %: measuring on is hardly worth its time")
