"""Campaigns: plan, which expands one or designs one."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ppshw.cli.answers import new_file, say, warn
from ppshw.cli.arguments import machine_of
from ppshw.errors import BadInput
from ppshw.progress import Bar, folded
from ppshw.quantities import many
from ppshw.whole_file import written_whole

if TYPE_CHECKING:
    from ppshw.identification.joint import Estimate
    from ppshw.machine import Machine
    from ppshw.recording import Recording


def plan(a: argparse.Namespace) -> None:
    """plan: a script's visits; or, with --visits, --accuracy or --after, the design of a new script."""
    from campaigns.plan import plan_campaign
    from campaigns.script import load_script
    from ppshw.machine import doubts

    machine = machine_of(a)
    warn(machine.file, warnings := doubts(machine))
    answer: dict[str, Any] = {"warnings": warnings}
    lines: list[str] = []
    asked = {f"--{k}": v for k, v in vars(a).items() if k in _OF_A_DESIGN and v is not None}
    if a.joint is not None and a.to_separate is None:
        raise BadInput("plan: --joint says where --to-separate looks, and there is none")
    if a.to_separate is not None:
        _separated(a, machine, answer)
        return
    if a.campaign is not None:
        if asked:
            raise BadInput(f"{next(iter(asked))}: designs a new campaign, and '{a.campaign}' is one already")
        found = plan_campaign(load_script(a.campaign), machine)
    else:
        designed, lines = _designed(a, machine, answer, asked)
        if designed is None:
            say(a, answer, folded(lines))
            return
        found = designed
    summary = found.summary()
    answer |= summary.as_dict()
    lines = [
        f"{found.script.name} on {machine.name}: {many(summary.visits, 'visit')}, {many(summary.readings, 'reading')}, "
        f"{many(summary.load_changes, 'load change')}, about {_hours(summary.duration_s)}",
        *(f"  {step:28}{many(count, 'visit'):>12}" for step, count in summary.steps.items()),
        *lines,
    ]
    if a.visibility or (a.campaign is not None and len(found.visits) <= _FORESEEN):
        from campaigns.foresight import ASSUMED, foresee

        foresight = foresee(found)
        answer["visibility"], answer["assumed"] = foresight.rows, ASSUMED
        lines += foresight.warnings() + (foresight.table() if a.visibility else [])
    text = folded(lines)
    if a.list:
        names = machine.joint_names
        answer["plan"] = [
            {"index": v.index, "step": v.step, "load": v.load, "setpoints": dict(zip(names, v.setpoints, strict=True))}
            for v in found.visits
        ]
        step, load = (max(len(getattr(v, label)) for v in found.visits) for label in ("step", "load"))
        head = "visit, step, load, " + ", ".join(f"{joint.name} [{joint.unit}]" for joint in machine.joints)
        rows = [f"{v.number:4} {v.step:{step}} {v.load:{load}}" + "".join(f" {x:7.4f}" for x in v.setpoints)
                for v in found.visits]  # fmt: skip
        text = "\n".join([text, folded([head]), *rows])
    say(a, answer, text)


_FORESEEN = 1000  # visits up to which a plan says unasked what it is blind to: two seconds
_OF_A_DESIGN = ("visits", "accuracy", "after", "calibration", "loads", "load_cases", "point", "out", "seed")
_SEED = 1  # where none is given


def _designed(
    a: argparse.Namespace, machine: Any, answer: dict[str, Any], asked: dict[str, Any]
) -> tuple[Any, list[str]]:
    """A new campaign in --out, or None where nothing is left to measure; with what is to be said."""
    from campaigns.design.ask import Question
    from campaigns.design.ask import answer as design
    from campaigns.script import load_script
    from ppshw.calibration import load_calibration
    from ppshw.recording import load_recording

    if a.visits is None and a.accuracy is None and a.after is None:
        raise BadInput("plan: expected a campaign to expand, or --visits, --accuracy or --after to design one")
    if a.visits is not None and a.accuracy is not None:
        raise BadInput("plan: --visits and --accuracy cannot both be asked for")
    if a.after is not None and a.calibration is not None:
        raise BadInput("plan: --calibration is not needed with --after, which identifies the recording itself")
    if a.out is None:
        raise BadInput("plan: --out CAMPAIGN.yaml is missing: where the designed campaign goes")
    out = new_file("campaign", a.out, machine.file, *(x for x in (a.after, a.calibration, a.loads) if x))
    seed = _SEED if a.seed is None else a.seed
    words = " ".join(f"{key.replace('_', '-')} {Path(str(v)).name if key != '--accuracy' else f'{v * 1e3:g}mm'}"
                     for key, v in asked.items() if key not in ("--out", "--seed"))  # fmt: skip
    recording = None if a.after is None else load_recording(a.after, machine)
    calibration = None if a.calibration is None else load_calibration(a.calibration, machine)
    loads = None if a.loads is None else load_script(a.loads)
    with Bar() as bar, written_whole(out, may_be_missing=True) as partial:
        estimate = None if recording is None else _identified(a, machine, recording, answer, bar)
        question = Question(
            machine, a.visits, a.accuracy, recording, calibration, loads, a.load_cases, a.point, seed, out.stem,
            f"ppshw plan {words} --seed {seed}", estimate,
        )  # fmt: skip
        found = design(question, partial, lambda stage: lambda k, n: bar(stage, k, n))
    answer.update(found.numbers, out=None if found.plan is None else a.out)
    return found.plan, [*found.lines, *([] if found.plan is None else [a.out])]


def _identified(
    a: argparse.Namespace, machine: Machine, recording: Recording, answer: dict[str, Any], bar: Bar
) -> Estimate:
    """What --after shows, refused and doubted as `identify` does."""
    from ppshw.cli.fit import fitted

    estimate, *_, warnings = fitted(a.after, machine, recording, "joint", lambda k, n: bar("identify", k, n))
    said = {f"{machine.file}: {line}" for line in answer["warnings"]}
    warnings = [line for line in warnings if line not in said]
    warn(a.after, warnings)
    answer["warnings"] = [*answer["warnings"], *warnings]
    return estimate


def _separated(a: argparse.Namespace, machine: Any, answer: dict[str, Any]) -> None:
    """--to-separate A,B: the visits that tell two effects apart, after a recording or a planned campaign."""
    from campaigns.design.separate import Wanted, separate
    from campaigns.plan import plan_campaign
    from campaigns.script import load_script
    from ppshw.recording import load_recording

    effects = tuple(name.strip() for name in a.to_separate.split(","))
    if len(effects) != 2 or effects[0] == effects[1]:
        raise BadInput(f"--to-separate {a.to_separate}: expected two different effects and a comma between them")
    if (a.campaign is None) == (a.after is None):
        raise BadInput("plan: --to-separate needs what there is so far: a campaign, or --after REC")
    for given in ("accuracy", "calibration", "load_cases", "point", "list", "visibility"):
        if getattr(a, given) not in (None, False):
            raise BadInput(f"plan: --{given.replace('_', '-')} has no meaning with --to-separate")
    if a.joint is not None and a.joint not in machine.joint_names:
        raise BadInput(f"--joint {a.joint}: no such joint (there are: {', '.join(machine.joint_names)})")
    if a.out is None:
        raise BadInput("plan: --out CAMPAIGN.yaml is missing: where the visits go")
    out = new_file("campaign", a.out, machine.file, *(x for x in (a.after, a.campaign, a.loads) if x))
    so_far: Any = (
        plan_campaign(load_script(a.campaign), machine) if a.after is None else load_recording(a.after, machine)
    )
    seed = _SEED if a.seed is None else a.seed
    loads = None if a.loads is None else load_script(a.loads).loads
    words = f"ppshw plan --to-separate {a.to_separate}" + (f" --joint {a.joint}" if a.joint else "")
    words += f" --loads {Path(a.loads).name}" if a.loads else ""
    words += f" {'' if a.after is None else '--after '}{Path(a.after or a.campaign).name} --seed {seed}"
    with Bar() as bar:
        estimate = None if a.after is None else _identified(a, machine, so_far, answer, bar)
        wanted = Wanted(
            machine, (effects[0], effects[1]), a.joint, so_far, a.visits, seed, out.stem, words, loads, estimate
        )
        found = separate(wanted, lambda k, n: bar("candidates", k, n))
    visits = sum(len(block.q) for block in found.blocks)
    answer.update(separation=found.rows, visits=visits, duration_s=0.0, out=a.out if visits else None)
    if not visits:
        say(a, answer, folded([*found.lines(), found.why_none()]))
        return
    with written_whole(out, may_be_missing=True) as partial:
        partial.write_text(found.text, encoding="utf-8")
    answer["duration_s"] = took = plan_campaign(load_script(out), machine).summary().duration_s
    lines = [*found.lines(), f"{visits} visits, about {_hours(took)}", a.out]
    if a.after is not None and loads is None and not so_far.has_wrench and any(b.case.mass > 0 for b in found.blocks):
        lines.insert(-1, "loads are supposed, as no wrench says what hung there; --loads says what there is")
    say(a, answer, folded(lines))


def _hours(seconds: float) -> str:
    minutes = round(seconds / 60)
    return f"{minutes // 60} h {minutes % 60:02d} min" if minutes >= 60 else f"{minutes} min"
