"""Runs a plan on a bench into a recording, one committed visit after the other.

A visit is: load change if the plan asks for one, move, settle, measure the targets, read wrench and temperatures, and
one transaction that holds all of it. A kill at any instruction costs at most the visit in hand; the same command again
goes on behind the last one. Trouble of any kind stops the axes, is logged with device and cause, and is raised again:
nothing is retried behind the operator's back.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from campaigns import run_notes
from campaigns.bench import Bench
from campaigns.design.loads import wrench as weighs
from campaigns.operator import Command, Operator
from campaigns.plan import Plan, Visit, check_setpoints
from campaigns.steadiness import Steadiness
from drivers.ports import Shot, WrenchReading, not_stopped
from ppshw.errors import (
    BeamLost,
    CampaignError,
    CompensationRefused,
    HardwareError,
    PpshwError,
    RecordingError,
    RunFailed,
    Stopped,
)
from ppshw.recording import LOAD_AGE, Around, columns_for
from ppshw.recording_file import RecordingFile

Array = NDArray[np.float64]
# (wanted setpoints (n,), measured wrench (6,) in the sensor frame, joint values now (n,), what is around) → setpoints
# to command (n,). The wrench is the one at the pose `now`: the payload's weight turns in the sensor frame as the
# machine moves.
SetpointMap = Callable[[Array, Array, Array, Around], Array]
LOOK_S = 1.0  # between two looks at the axes while the run waits: less than a drive's silence that counts, by default
# m or rad; loaded, braked and let go, an axis that is held gives way by less (a guess). Which side it came from is
# known where it stands as it stood: moves of a run that was broken off may be shorter than that.
SLIP, SAME_PLACE = 5e-4, 5e-5
# A load of less is not weighed; of one that is, the force sensor reads at least such a share (newtons read as pounds
# are 0.22, as kilograms 0.10, as kilonewtons 0.001). Ours.
LEAST_WEIGHED_N, LEAST_OF_A_LOAD = 50.0, 0.5
# A load that sways while it is weighed is weighed again, so often, after so long each time. Ours.
WEIGHED_AGAIN, AGAIN_AFTER_S = 5, 2.0
SUSPENDED_FOR_S = 60.0  # how long between two looks at a thermometer that is outside its window


@dataclass(frozen=True)
class Progress:
    """After each visit: how many are done of how many, and the machine time that the rest takes."""

    done: int
    total: int
    seconds_left: float
    visit: Visit


@dataclass(frozen=True)
class RunResult:
    """measured: in this run; done: in the recording; skipped: left out on the operator's word."""

    out: Path
    measured: int
    done: int
    skipped: int
    lost_beams: int


def run_campaign(
    plan: Plan,
    bench: Bench,
    out: Path | str,
    operator: Operator,
    *,
    setpoint_map: SetpointMap | None = None,
    map_label: str = "compensated",
    progress: Callable[[Progress], None] | None = None,
    reset_faults: bool = False,
) -> RunResult:
    """Run what the recording `out` does not hold yet; creates it when it is new. `bench` is entered, not started.

    setpoint_map  corrects every visit's setpoints before they are commanded; q_cmd in the recording is what was
                  commanded, cov_wanted_<joint> what was wanted
    map_label     says in the recording which correction that was (a calibration's hash); one recording, one correction
    reset_faults  acknowledge the drives' faults before starting: the operator has seen to the cause
    """
    run = _Run(plan, bench, Path(out), operator, setpoint_map, map_label, progress)
    return run.go(reset_faults)


class _Run:
    """One run of a plan: the open recording, and what load is on."""

    def __init__(
        self,
        plan: Plan,
        bench: Bench,
        out: Path,
        operator: Operator,
        setpoint_map: SetpointMap | None,
        map_label: str,
        progress: Callable[[Progress], None] | None,
    ) -> None:
        self._plan, self._bench, self._out, self._operator = plan, bench, out, operator
        self._map, self._map_label, self._progress = setpoint_map, map_label, progress
        self._joints = plan.machine.joint_names
        self._load: str | None = None
        self._mass = 0.0  # of that load, as the operator says [kg]
        self._put_on = math.nan  # when it was put on [s] since 1970
        self._came: dict[str, int] = {}  # from which side joints came that stand where a broken-off run left them
        self._lay_before: Array | None = None  # wrench before that
        self._steadiness = Steadiness()
        self._noticed: str | None = None  # when trouble was noticed, where it is raised later
        self._measured = 0
        self._lost = 0

    def go(self, reset_faults: bool) -> RunResult:
        meta = run_notes.identity(self._plan, self._map_label if self._map else "as planned")
        existing = self._out.exists()
        if existing:  # look before any axis is enabled
            with RecordingFile.open(self._out) as file:
                run_notes.refuse_another_run(file, meta)
                if self._all_done(file):
                    return self._result(file)
                self._require_later(run_notes.last_visit(file))
        elif not self._out.parent.is_dir():
            raise RecordingError(f"{self._out}: the folder {self._out.parent} does not exist")
        try:
            devices = self._bench.start(reset_faults)
            places = self._bench.places
            with self._open(existing, meta, places) as file:
                note = run_notes.start_note(devices, self._bench)
                if existing and note["site_sha256"] != file.meta().get("site_sha256", ""):
                    note["site"] = self._bench.notes.get("site", "")
                    self._operator.tell("The site file is another than the recording was begun with; both are kept.")
                if existing and (others := run_notes.exchanged(file, devices)):
                    self._operator.tell(f"Other devices than before: {others}. Unless they were changed, abort.")
                self._log(file, "start", "resumed" if existing else "started", note)
                if existing:
                    self._say_what_moved(file)
                return self._visits(file)
        except KeyboardInterrupt:
            self._bench.stop()
            held = "holds everything up to the last visit" if self._out.exists() else "was not begun"
            raise Stopped(f"stopped by the operator; {self._out} {held}") from None
        except BaseException:
            self._bench.stop()
            raise

    # --- the recording -------------------------------------------------------------------------------------
    def _open(self, existing: bool, meta: Mapping[str, str], places: Sequence[str]) -> RecordingFile:
        if not existing:
            wanted = [f"wanted_{j}" for j in self._joints] if self._map else []
            columns = [*columns_for(self._plan.machine, places, self._plan.extra_targets, wanted), LOAD_AGE]
            origin = run_notes.origin(self._plan)
            return RecordingFile.create(self._out, columns, {**meta, **origin, **self._bench.notes})
        file = RecordingFile.open(self._out)
        last_visit = run_notes.last_visit(file)
        if missing := ", ".join(p for p in places if f"temp_{p}_C" not in last_visit):
            file.close()
            raise RecordingError(f"{self._out}: cannot be continued: no column for the temperature of {missing}")
        return file

    def _require_later(self, last_visit: Mapping[str, str]) -> None:
        if (now := self._now()) < (last := last_visit["time"]):
            raise RecordingError(f"{self._out}: cannot be continued: its last visit is of {last}, now is {now}")

    def _say_what_moved(self, file: RecordingFile) -> None:
        """Since the last visit, for the operator to judge: a move that was broken off or somebody who moved the machine
        is no reason to refuse, but a drive that lost its zero says no more than this. Axes that were homed stand on
        their switch."""
        last, now = run_notes.last_visit(file), self._bench.axes.positions()
        before = {j: float(q) for j in self._joints if (q := last.get(f"q_{j}"))}
        unmoved = [j for j in before if j not in self._bench.homed and abs(now[j] - before[j]) <= SLIP]
        same = [j for j in unmoved if abs(now[j] - before[j]) <= SAME_PLACE]
        self._came = {j: int(side) for j in same if (side := last.get(f"approach_{j}"))}
        moved = {j: (before[j], now[j]) for j in before if j not in (*self._bench.homed, *unmoved)}
        if not moved:
            return
        units = {joint.name: joint.unit for joint in self._plan.machine.joints}
        text = "; ".join(f"{j} {was:.6g} → {now:.6g} {units[j]}" for j, (was, now) in moved.items())
        text = f"since the last visit axes have moved: {text}"
        self._log(file, "moved", text, {j: list(both) for j, both in moved.items()})
        self._operator.tell(
            f"{text[0].upper()}{text[1:]}. Unless a move was broken off or somebody moved them, their zero is lost: "
            "then abort before they move again."
        )

    def _log(self, file: RecordingFile, kind: str, text: str, data: Mapping[str, Any] | None = None) -> None:
        file.log(self._now(), kind, text, data)

    def _now(self) -> str:
        return self._bench.clock.utc().isoformat(timespec="milliseconds")

    def _all_done(self, file: RecordingFile) -> bool:
        return len(run_notes.finished(file)) >= len(self._plan.visits)

    def _result(self, file: RecordingFile) -> RunResult:
        return RunResult(self._out, self._measured, len(file.done()), len(run_notes.skipped(file)), self._lost)

    # --- the loop ------------------------------------------------------------------------------------------
    def _visits(self, file: RecordingFile) -> RunResult:
        finished = run_notes.finished(file)
        todo = [visit for visit in self._plan.visits if visit.index not in finished]
        last: Visit | None = None
        seconds_left = self._plan.seconds_left(finished)
        try:
            while True:  # once more after the last visit: what was asked for meanwhile
                visit = todo[0] if todo else None
                command = self._obey(file, self._operator.command(), visit, last)
                if command is None and visit is not None:
                    command = self._wait_for_temperature(file, visit, last)
                if command is Command.REDO:
                    assert last is not None
                    todo.insert(0, last)  # what was measured stays until it has been measured again
                    last = None
                    seconds_left += self._plan.durations[todo[0].index]
                    continue
                if visit is None:
                    break
                if command is not Command.SKIP:
                    self._change_load(file, visit)
                    self._visit(file, visit)
                    self._measured += 1
                if visit.index in file.done():  # or was not measured again
                    last = visit
                todo.pop(0)
                seconds_left -= self._plan.durations[visit.index]
                if self._progress is not None:
                    done = len(self._plan.visits) - len(todo)
                    self._progress(Progress(done, len(self._plan.visits), max(0.0, seconds_left), visit))
            self._baseline(file, "after the last visit")
        except BaseException as error:
            self._bench.stop()
            try:
                self._log_trouble(file, error, todo[0] if todo else None)
            except PpshwError as second:  # the first is the cause
                error.add_note(f"while it was logged: {second}")
            raise
        self._log(file, "end", f"{len(file.done())} of {len(self._plan.visits)} visits measured")
        return self._result(file)

    def _visit(self, file: RecordingFile, visit: Visit) -> None:
        bench = self._bench
        wanted = np.array(visit.setpoints)
        if visit.via is not None:  # before the correction, which may depend on where the machine comes from
            bench.axes.move(dict(zip(self._joints, visit.via, strict=True)))
        commanded = self._corrected(visit, wanted)
        report = bench.axes.move(dict(zip(self._joints, commanded.tolist(), strict=True)))
        approach = {j: side or self._came.get(j, 0) for j, side in report.approach.items()}
        rest = self._plan.script.settle_s - (bench.clock.now() - report.ended_at)
        self._wait(rest, report.positions)
        settled_s, time = bench.clock.now() - report.ended_at, self._now()
        load_age_s = bench.clock.utc().timestamp() - self._put_on
        q = bench.axes.positions()
        shots = self._shots(file, visit, np.array([q[j] for j in self._joints]))
        reading = self._felt(file, visit, q)
        temperatures = bench.temperatures()
        bench.axes.require_at_rest(q)  # an axis that fell over during the measurement, or was pushed, spoils it
        cells = {"time": time, "step": visit.step, "load": visit.load, "settle_s": f"{settled_s:.3f}"}
        cells |= run_notes.joint_cells(self._joints, commanded, q, approach)
        if LOAD_AGE in file.columns() and math.isfinite(load_age_s):  # else the recording was begun without it
            cells[LOAD_AGE] = f"{load_age_s:.1f}"
        for shot in shots:
            cells |= {f"{shot.target}_{axis}": f"{x:.9f}" for axis, x in zip("xyz", shot.xyz.tolist(), strict=True)}
        cells |= {f"temp_{place}_C": f"{value:.4f}" for place, value in temperatures.items()}
        if reading is not None:
            cells |= run_notes.wrench_cells(reading)
        if self._map is not None:
            cells |= {f"cov_wanted_{j}": f"{x:.9f}" for j, x in zip(self._joints, wanted.tolist(), strict=True)}
        raw = [(s.target, run_notes.raw(s)) for s in shots]
        if reading is not None:
            raw.append(("wrench", run_notes.raw_wrench(reading)))
        file.append(cells, plan_index=visit.index, shots=raw, again=visit.index in file.done())

    def _felt(self, file: RecordingFile, visit: Visit, at: Mapping[str, float]) -> WrenchReading | None:
        """The load, when it hangs still; where it goes on swaying, as it is, and the operator is told."""
        if self._bench.force_sensor is None:
            return None
        reading = self._bench.force_sensor.read()
        self._steadiness.require_alive(self._bench.force_sensor.name, reading)
        sway, looks = self._steadiness.sway(reading), 0
        while sway is not None and looks < WEIGHED_AGAIN:
            self._wait(AGAIN_AFTER_S, at)
            reading, looks = self._bench.force_sensor.read(), looks + 1
            sway = self._steadiness.sway(reading)
        if sway is not None:
            text = f"visit {visit.number}: the load sways while it is weighed: {sway}"
            self._log(file, "sway", text, {"visit": visit.index, **run_notes.raw_wrench(reading)})
            self._operator.tell(f"{text}. Let it hang still, and have the visit measured again.")
        return reading

    def _corrected(self, visit: Visit, wanted: Array) -> Array:
        if self._map is None:
            return wanted
        now = self._bench.axes.positions()
        here = np.array([now[j] for j in self._joints])
        if self._bench.force_sensor is not None:
            wrench = self._bench.force_sensor.read().wrench
        else:  # what the script's load weighs, as corrected_plan has it
            wrench = weighs(self._plan.machine, here[None], self._mass, np.array(self._plan.loads[visit.load].com))[0]
        put_on = self._put_on, self._lay_before
        around = Around(self._bench.clock.utc().timestamp(), visit.load, self._bench.temperatures(), *put_on)
        who = f"visit {visit.number} ({visit.step}), corrected"
        try:
            commanded = np.asarray(self._map(wanted, wrench, here, around), dtype=float)
            check_setpoints(commanded.tolist(), self._plan.machine, who)
        except CompensationRefused as refused:
            raise RunFailed(f"{who}: {refused}") from refused
        except CampaignError as beyond:
            raise RunFailed(str(beyond)) from beyond
        return commanded

    def _shots(self, file: RecordingFile, visit: Visit, q: Array) -> list[Shot]:
        self._bench.tracker.set_atmosphere(self._bench.atmosphere())
        shots: list[Shot] = []
        for target in visit.targets:
            try:
                shots.append(self._bench.tracker.measure(target, self._bench.aim(q, target)))
            except BeamLost as lost:
                if self._plan.script.on_lost_beam == "stop":
                    raise
                self._lost += 1
                self._log(file, "beam lost", str(lost), {"visit": visit.index, "target": target})
        return shots

    # --- what stands between visits ------------------------------------------------------------------------
    def _change_load(self, file: RecordingFile, visit: Visit) -> None:
        """After a resume too: nobody knows what lies on the machine, so the operator is asked."""
        if visit.load == self._load:
            return
        load = self._plan.loads.get(visit.load)
        assert load is not None, f"visit {visit.number} has a load '{visit.load}' that the script does not define"
        lies = run_notes.put_on_since(file, load.name) if self._load is None else None
        lay_there = self._load is None and run_notes.last_visit(file).get("load") == load.name  # all the time, perhaps
        self._lay_before = self._baseline(file, f"before the change to load {load.name}")
        asked, began = self._now(), self._bench.clock.utc().timestamp()
        with self._watched():
            answer = self._operator.change_load(load)
        self._put_on = math.nan if lay_there else 0.5 * (began + self._bench.clock.utc().timestamp())
        if lies is not None:
            self._put_on, self._lay_before = lies
        mass = load.mass if answer.mass is None else answer.mass
        note = {"asked": asked, "operator": answer.name, "mass_kg": mass, **asdict(load)}
        text = f"{load.name}: {mass:g} kg put on by {answer.name}"
        text += "" if mass == load.mass else f", {load.mass:g} kg were asked for"
        self._log(file, "load change", text, note)
        self._load, self._mass = load.name, mass
        self._weighed(file, load.name, mass, self._baseline(file, f"after the change to load {load.name}"))

    def _weighed(self, file: RecordingFile, load: str, mass: float, felt: Array | None) -> None:
        """Raises RunFailed where the force sensor reads less than half of a load's weight: a load that is not on, or a
        sensor that says other units than newtons, costs a campaign. What else it bears nobody knows, so more may be
        right."""
        weight = mass * float(np.linalg.norm(self._plan.machine.gravity))
        if self._bench.force_sensor is None or weight < LEAST_WEIGHED_N:
            return
        felt = self._bench.force_sensor.read().wrench if felt is None else felt
        read = float(np.linalg.norm(felt[:3]))
        if read < LEAST_OF_A_LOAD * weight:
            self._log(file, run_notes.NOT_ON, f"{load}: {read:.3g} N of {weight:.0f} N", {"name": load})
            raise RunFailed(
                f"load '{load}' of {mass:g} kg weighs {weight:.0f} N, but {self._bench.force_sensor.name} reads "
                f"{read:.3g} N: is it on the machine, and does the sensor say newtons ('zero' and 'matrix' in the site "
                "file)?"
            )

    def _baseline(self, file: RecordingFile, when: str) -> Array | None:
        if not self._plan.script.baseline or self._bench.force_sensor is None:
            return None
        reading = self._bench.force_sensor.read()
        self._log(file, "baseline", when, {**run_notes.raw_wrench(reading), "q": self._bench.axes.positions()})
        return reading.wrench

    def _wait_for_temperature(self, file: RecordingFile, visit: Visit, last: Visit | None) -> Command | None:
        """Returns when all places are inside their window, or what the operator wants done instead of waiting."""
        window = self._plan.script.temperature
        if window is None:
            return None
        suspended, at = False, self._bench.axes.positions()
        while True:
            outside = {p: t for p, t in self._bench.temperatures().items() if not window[0] <= t <= window[1]}
            if not outside:
                if suspended:
                    self._log(file, "released", "temperatures are back inside their window")
                return None
            if not suspended:
                text = ", ".join(f"{place} at {t:.2f} °C" for place, t in outside.items())
                text = f"suspended: {text}, outside {window[0]:g} … {window[1]:g} °C"
                self._log(file, "suspended", text, outside)
                self._operator.tell(text)
            suspended = True
            command = self._operator.command()
            if command is Command.ABORT:
                raise Stopped("stopped by the operator while suspended")
            if (wanted := self._obey(file, command, visit, last)) is not None:
                if command is not Command.PAUSE:  # else the end of the pause says it
                    self._log(file, "released", f"operator: {wanted.name.lower()}")
                return wanted
            self._wait(SUSPENDED_FOR_S, at)

    def _obey(
        self, file: RecordingFile, command: Command | None, visit: Visit | None, last: Visit | None
    ) -> Command | None:
        """Returns SKIP or REDO where that is to be done, None where the run goes on. `visit` is the next one, None
        after the last."""
        when = "after the last visit" if visit is None else f"before visit {visit.number}"
        if command is Command.PAUSE:
            self._log(file, "paused", when)
            with self._watched():
                command = self._operator.wait_for_command(f"Paused {when}.")
            self._log(file, "released", f"operator: {command.name.lower()}")
        if command is Command.ABORT:
            of = "" if visit is None else f" of {len(self._plan.visits)}"
            raise Stopped(f"stopped by the operator {when}{of}")
        if command is Command.SKIP:
            if visit is None:
                self._operator.tell(f"Nothing to skip {when}.")
                return None
            text = f"visit {visit.number} left out by the operator"
            if visit.index in file.done():
                text = f"visit {visit.number} is not measured again: what was measured of it stays"
                self._operator.tell(f"{text[0].upper()}{text[1:]}.")
            self._log(file, "skip", text, {"visit": visit.index})
            return command
        if command is Command.REDO and last is not None:
            self._log(file, "redo", f"visit {last.number} is measured again", {"visit": last.index})
            return command
        if command is Command.REDO:
            stands = "has been measured" if visit is None else f"stands {when}"
            self._operator.tell(f"Nothing to redo: no visit of this run {stands}.")
        return None

    def _wait(self, seconds: float, at: Mapping[str, float]) -> None:
        """The axes stand `at` meanwhile [m or rad]."""
        clock = self._bench.clock
        end = clock.now() + seconds
        while (left := end - clock.now()) > 0:
            clock.sleep(min(left, LOOK_S))
            self._bench.axes.require_at_rest(at, SLIP)

    @contextmanager
    def _watched(self) -> Iterator[None]:
        """Looks at the axes while a person is asked, who may take an hour. By real time: machine time that is stepped
        stands still while nobody steps it. What is found stops the axes at once, and is raised when the person has
        answered, also who answers by giving up."""
        answered, found = threading.Event(), list[Exception]()
        at = self._bench.axes.positions()

        def watch() -> None:
            while not answered.wait(LOOK_S):
                try:
                    self._bench.axes.require_at_rest(at, SLIP)
                except Exception as error:
                    self._bench.axes.quick_stop()
                    self._noticed = self._now()
                    found.append(error)
                    left = self._bench.axes.unstopped
                    stopped = not_stopped(left) if left else "The axes are stopped"
                    self._operator.tell(f"{error}. {stopped}, the run ends after your answer.")
                    return

        watcher = threading.Thread(target=watch, daemon=True)
        watcher.start()
        try:
            try:
                yield
            finally:
                answered.set()
                watcher.join()
        except BaseException as error:
            if found:
                found[0].add_note(f"at the prompt: {str(error) or 'interrupted'}")
                raise found[0] from error
            raise
        if found:
            raise found[0]

    def _log_trouble(self, file: RecordingFile, error: BaseException, visit: Visit | None) -> None:
        data: dict[str, Any] = {"visit": None if visit is None else visit.index, "error": type(error).__name__}
        if isinstance(error, HardwareError):
            note = {**data, "device": error.device, "cause": error.cause, "unstopped": list(self._bench.axes.unstopped)}
            if notes := getattr(error, "__notes__", []):
                note["notes"] = notes
            file.log(self._noticed or self._now(), "fault", str(error), note)
        else:
            self._log(file, "stopped", str(error) or "interrupted", data)
