"""A design as a campaign script (docs/campaigns.md), with its provenance in the first lines."""

from __future__ import annotations

import numpy as np
import yaml

from campaigns.design.designer import Design
from campaigns.script import LoadCase
from ppshw import __version__


def script_text(design: Design, name: str, asked: str) -> str:
    """The YAML of a campaign. `asked`: the command that the design was made by, in words."""
    request, machine = design.request, design.request.machine
    model, both = (1e3 * x for x in design.accuracy)
    joints = machine.joint_names
    lines = [
        f"# Designed by {asked}, version {__version__}, seed {request.seed}.",
        f"# Machine '{machine.name}', file {machine.sha256[:12]}. Poses have the least mean error variance at "
        f"'{request.point}'",
        f"# over the joints' whole travel and the loads of the work, as believed of {request.belief.origin}.",
        f"# Loads of the work: {_work(design)}.",
        f"# Predicted 98.6 % there: {model:.3f} mm of the model, {both:.3f} mm with noise, "
        f"{1e3 * design.floor:.3f} mm of noise alone.",
        f"# Travel {design.travel_s:.0f} s; no order of these visits and references needs less than "
        f"{design.bound_s:.0f} s.",
        f"name: {word(name)}",
        f"about: {design.visits} designed visits, {len(design.q)} poses and the reference pose in between",
        f"seed: {request.seed}",
        f"home: {joints_text(joints, design.reference)}",
        f"reference: {{every: {design.every}, q: {{}}, closing: true}}",
        "loads:",
        *(f"  - {load_text(case)}" for k, case in enumerate(request.cases) if (design.load == k).any()),
        "steps:",
        "  - step: designed",
        "    kind: poses",
        "    poses:",
    ]
    for q, load in zip(design.q, design.load, strict=True):
        lines.append(f"      - {{load: {word(request.cases[load].name)}, q: {joints_text(joints, q)}}}")
    return "\n".join(lines) + "\n"


def joints_text(names: tuple[str, ...], q: np.ndarray[tuple[int], np.dtype[np.float64]]) -> str:
    return "{" + ", ".join(f"{word(name)}: {float(x) + 0.0:.4f}" for name, x in zip(names, q, strict=True)) + "}"


def load_text(case: LoadCase) -> str:
    com = "" if case.mass == 0 else f", com: [{', '.join(f'{x:g}' for x in case.com)}]"
    return f"{{name: {word(case.name)}, mass: {case.mass:g}{com}}}"


def word(text: str) -> str:
    """A text as YAML has it, also between braces: in quotes where it would be read as something else."""
    listed = str(yaml.safe_dump([text], width=100_000, allow_unicode=True, default_flow_style=True))
    return listed.strip().removeprefix("[").removesuffix("]")


def _work(design: Design) -> str:
    work = design.request.work
    if work.mass[1] == 0:
        return "none"
    box = ", ".join(f"{axis} {a:.2f} … {b:.2f} m" for axis, a, b in zip("xyz", work.low, work.high, strict=True))
    return f"{work.mass[0]:g} … {work.mass[1]:g} kg, centre at {box}"
