"""Campaign script (YAML) → Script: what shall be measured, before any machine is known. The form: docs/campaigns.md.

Every step keeps the place it was written at, so that a setpoint beyond a limit is reported with file and line by the
plan, which knows the machine.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np

from ppshw.errors import CampaignError
from ppshw.strict_yaml import Section, read_yaml

# Scripts of ours that name no joint and no target; the others are the positioner's.
ON_ANY_MACHINE = ("diagnosis", "quick")
DIRECTIONS = ("up", "down", "both")
ORDERS = ("by_load", "as_written")
# Where a script does not say: to stand still, for one target, to put another load on [s].
SETTLE_S, MEASURE_S, LOAD_CHANGE_S = 5.0, 4.0, 600.0
HEAVIEST = 1e5  # kg; what no force sensor's reading may say either


@dataclass(frozen=True)
class LoadCase:
    """What the operator puts on: mass [kg], com (3,) its centre of mass in the end-effector frame [m].

    mass 0 is the empty machine: what is fitted for good (couch, equipment) and nothing else.
    """

    name: str
    mass: float
    com: tuple[float, float, float]


EMPTY = LoadCase("empty", 0.0, (0.0, 0.0, 0.0))


@dataclass(frozen=True)
class Step:
    """One block of a script. `where` is file:line."""

    name: str
    where: str
    loads: tuple[str, ...]
    repeat: int
    shuffle: bool
    targets: tuple[str, ...]


@dataclass(frozen=True)
class Pose:
    """q: the joints that are not at home; load: None for all the step's loads."""

    q: Mapping[str, float]
    load: str | None
    where: str


@dataclass(frozen=True)
class PosesStep(Step):
    poses: tuple[Pose, ...]


@dataclass(frozen=True)
class SweepStep(Step):
    """One joint over its travel, the others at home (or at `at`).

    positions  given values; empty: `count` equally spaced from `first` to `last` (None: the joint's limit)
    """

    joint: str
    positions: tuple[float, ...]
    count: int
    first: float | None
    last: float | None
    margin: float
    direction: str
    at: Mapping[str, float]


@dataclass(frozen=True)
class Volume:
    """A box in the base frame that a point on the couch must stay in: low, high (3,) [m]."""

    point: str
    low: tuple[float, ...]
    high: tuple[float, ...]


@dataclass(frozen=True)
class RandomStep(Step):
    """`count` poses drawn uniformly within the limits less `margin` (share of the travel, each side) and `within`.

    deal  True: each pose under one load, loads in turn; False: every pose under every load
    """

    count: int
    margin: float
    within: Mapping[str, tuple[float, float]]
    volume: Volume | None
    deal: bool


@dataclass(frozen=True)
class ReversalsStep(Step):
    """Every joint, or those named, turns back in moves of 0.4 to 20 % of its travel; `count` poses each."""

    count: int
    joints: tuple[str, ...]


@dataclass(frozen=True)
class Reference:
    """A pose measured again every `every` visits under whatever load is on, against drift; closing: at the end too."""

    every: int
    q: Mapping[str, float]
    where: str
    closing: bool = False


@dataclass(frozen=True)
class Script:
    """home_margin: share of a joint's travel that home, where `home` does not name the joint, stays off its limits;
    times in seconds; temperature: the window outside which a run waits for the operator, None: no window."""

    name: str
    about: str
    seed: int
    home: Mapping[str, float]
    home_margin: float
    targets: tuple[str, ...]
    settle_s: float
    measure_s: float
    load_change_s: float
    on_lost_beam: str
    order: str
    baseline: bool
    temperature: tuple[float, float] | None
    reference: Reference | None
    loads: tuple[LoadCase, ...]
    steps: tuple[Step, ...]
    file: str
    text: str
    sha256: str


def script_path(name: str) -> Path:
    """A script that comes with the package (`paper`, `verification`, …), or a path as it stands."""
    given = Path(name)
    if given.suffix or given.exists():
        return given
    shipped = files("campaigns") / "scripts" / f"{name}.yaml"
    if not shipped.is_file():
        known = ", ".join(shipped_scripts())
        raise CampaignError(f"{name}: no such file, and no script of that name (there are: {known})")
    return Path(str(shipped))


def shipped_scripts() -> list[str]:
    found = (files("campaigns") / "scripts").iterdir()
    return sorted(entry.name.removesuffix(".yaml") for entry in found if entry.name.endswith(".yaml"))


def not_on_any_machine(where: str) -> str:
    """What else to say where a machine has not the names of a script, at `where` (file, or file:line): of one that
    comes with the package, which ones go with any machine."""
    ours = where.startswith(str(files("campaigns") / "scripts"))
    return f"; of the scripts that come with ppshw {' and '.join(ON_ANY_MACHINE)} go with any machine" if ours else ""


def load_script(path: Path | str) -> Script:
    """Read and check a campaign script. Raises CampaignError naming file, line and key."""
    path = script_path(str(path))
    top = read_yaml(path, CampaignError)
    file = str(path)
    seed = top.integer("seed", default=1, low=0)
    loads = _loads(top, seed)
    targets = tuple(top.texts("targets", default=()))
    script = Script(
        name=top.text("name"),
        about=top.text("about", default=""),
        seed=seed,
        home=_joint_values(top, "home"),
        home_margin=top.number("home_margin", default=0.0, low=0.0, high=0.5),
        targets=targets,
        settle_s=top.number("settle_s", default=SETTLE_S, low=0.0),
        measure_s=top.number("measure_s", default=MEASURE_S, low=0.0),
        load_change_s=top.number("load_change_s", default=LOAD_CHANGE_S, low=0.0),
        on_lost_beam=top.text("on_lost_beam", default="stop", choices=("stop", "skip")),
        order=top.text("order", default="by_load", choices=ORDERS),
        baseline=top.flag("baseline", default=True),
        temperature=_window(top),
        reference=_reference(top, file),
        loads=tuple(case for cases in loads.values() for case in cases),
        steps=tuple(_step(section, file, loads, targets) for section in top.sections("steps")),
        file=file,
        text=path.read_text(encoding="utf-8"),
        sha256=hashlib.sha256(path.read_bytes()).hexdigest(),
    )
    top.done()
    if not script.steps:
        top.fail("'steps' is empty, expected at least one step", "steps")
    seen: set[str] = set()
    for step in script.steps:
        if step.name in seen or step.name == "reference":
            raise CampaignError(f"{step.where}: step name '{step.name}' is used twice or reserved")
        seen.add(step.name)
    return script


# --- loads ---------------------------------------------------------------------------------------------------
def _loads(top: Section, seed: int) -> dict[str, tuple[LoadCase, ...]]:
    """Named entries; a random entry stands for several load cases."""
    out: dict[str, tuple[LoadCase, ...]] = {}
    for k, section in enumerate(top.sections("loads", optional=True)):
        name = section.text("name")
        if name in out:
            section.fail(f"load '{name}' is defined twice", "name")
        if "random" in section:
            out[name] = _random_loads(section, name, np.random.default_rng([seed, 1000 + k]))
        else:
            mass = section.number("mass", low=0.0, high=HEAVIEST)
            com = section.vector("com", 3, default=(0.0, 0.0, 0.0))
            out[name] = (LoadCase(name, mass, (float(com[0]), float(com[1]), float(com[2]))),)
        known = {case.name for cases in list(out.values())[:-1] for case in cases}
        if twice := [case.name for case in out[name] if case.name in known]:
            section.fail(f"load '{twice[0]}' is defined twice", "name")
        section.done()
    return out or {"empty": (EMPTY,)}


def _random_loads(section: Section, name: str, rng: np.random.Generator) -> tuple[LoadCase, ...]:
    """`random: n` load cases, mass and centre of mass uniform in the ranges given; whole kilograms and millimetres."""
    count = section.integer("random", low=1, high=1000)
    box = section.need("com")
    ranges = [_range(section, "mass"), *(_range(box, axis) for axis in "xyz")]
    if not 0.0 <= ranges[0][0] <= ranges[0][1] <= HEAVIEST:
        section.fail(f"'{section.path('mass')}' must lie between 0 and {HEAVIEST:g} kg", "mass")
    box.done()
    low, high = np.array(ranges).T
    drawn = rng.uniform(low, high, size=(count, 4))
    return tuple(
        LoadCase(f"{name}-{k + 1:0{len(str(count))}d}", round(float(m), 0), (round(x, 3), round(y, 3), round(z, 3)))
        for k, (m, x, y, z) in enumerate(drawn.tolist())
    )


def _range(section: Section, key: str) -> tuple[float, float]:
    low, high = section.vector(key, 2).tolist()
    if low > high:
        section.fail(f"'{section.path(key)}' runs from {low:g} down to {high:g}", key)
    return low, high


# --- steps ---------------------------------------------------------------------------------------------------
def _step(section: Section, file: str, loads: Mapping[str, tuple[LoadCase, ...]], targets: tuple[str, ...]) -> Step:
    kind = section.text("kind", choices=("poses", "sweep", "random", "reversals"))
    wanted = section.texts("loads", default=list(loads), choices=tuple(loads))
    name, where = section.text("step"), f"{file}:{section.line}"
    cases = tuple(case.name for entry in wanted for case in loads[entry])
    repeat = section.integer("repeat", default=1, low=1, high=10_000)
    shuffle = section.flag("shuffle", default=False)
    asked = tuple(section.texts("targets", default=targets))
    step: Step
    if kind == "poses":
        poses = tuple(_pose(s, file, loads) for s in section.sections("poses"))
        if not poses:
            section.fail(f"'{section.path('poses')}' is empty", "poses")
        step = PosesStep(name, where, cases, repeat, shuffle, asked, poses)
    elif kind == "sweep":
        step = _sweep(section, name, where, cases, repeat, shuffle, asked)
    elif kind == "reversals":
        step = ReversalsStep(
            name, where, cases, repeat, shuffle, asked,
            count=section.integer("count", default=7, low=3, high=1000),
            joints=tuple(section.texts("joints", default=())),
        )  # fmt: skip
    else:
        within = section.section("within", optional=True)
        ranges = {} if within is None else {j: _range(within, j) for j in within.keys()}  # noqa: SIM118
        step = RandomStep(
            name, where, cases, repeat, shuffle, asked,
            count=section.integer("count", low=1, high=100_000),
            margin=section.number("margin", default=0.02, low=0.0, high=0.49),
            within=ranges,
            volume=_volume(section),
            deal=section.flag("deal", default=True),
        )  # fmt: skip
    section.done()
    if not wanted and not (isinstance(step, PosesStep) and all(pose.load for pose in step.poses)):
        section.fail(f"'{section.path('loads')}' is empty, expected at least one load, or none of this key", "loads")
    return step


def _sweep(
    section: Section, name: str, where: str, cases: tuple[str, ...], repeat: int, shuffle: bool, asked: tuple[str, ...]
) -> SweepStep:
    positions = tuple(section.vector("positions", None, default=()).tolist())
    if bool(positions) == ("count" in section):
        section.fail("expected either 'positions' or 'count'")
    return SweepStep(
        name, where, cases, repeat, shuffle, asked,
        joint=section.text("joint"),
        positions=positions,
        count=section.integer("count", default=len(positions), low=1, high=100_000),
        first=section.number("from", default=None),
        last=section.number("to", default=None),
        margin=section.number("margin", default=0.0, low=0.0, high=0.49),
        direction=section.text("direction", default="up", choices=DIRECTIONS),
        at=_joint_values(section, "at"),
    )  # fmt: skip


def _pose(section: Section, file: str, loads: Mapping[str, tuple[LoadCase, ...]]) -> Pose:
    load = None
    if "load" in section:
        cases = loads[section.text("load", choices=tuple(loads))]
        if len(cases) > 1:
            section.fail(f"'{section.path('load')}' stands for {len(cases)} load cases, expected one load", "load")
        load = cases[0].name
    pose = Pose(_joint_values(section, "q"), load, f"{file}:{section.line}")
    section.done()
    return pose


def _volume(section: Section) -> Volume | None:
    box = section.section("volume", optional=True)
    if box is None:
        return None
    ranges = [_range(box, axis) for axis in "xyz"]
    volume = Volume(box.text("point", default="tip"), tuple(r[0] for r in ranges), tuple(r[1] for r in ranges))
    box.done()
    return volume


def _reference(top: Section, file: str) -> Reference | None:
    section = top.section("reference", optional=True)
    if section is None:
        return None
    found = Reference(
        section.integer("every", low=1), _joint_values(section, "q"), f"{file}:{section.line}",
        section.flag("closing", default=False),
    )  # fmt: skip
    section.done()
    return found


def _window(top: Section) -> tuple[float, float] | None:
    section = top.section("temperature", optional=True)
    if section is None:
        return None
    low, high = section.number("min_C"), section.number("max_C")
    if not low < high:
        section.fail(f"'min_C' {low:g} is not below 'max_C' {high:g}", "min_C")
    section.done()
    return low, high


def _joint_values(section: Section, key: str) -> dict[str, float]:
    found = section.section(key, optional=True)
    if found is None:
        return {}
    out = {joint: float(found.number(joint)) for joint in found.keys()}  # noqa: SIM118
    found.done()
    return out
