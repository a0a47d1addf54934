"""Locate, name, model: what the base model (17) leaves unexplained in a recording, in the contract's words (§4)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.carried import Carried, carry
from ppshw.diagnosis.checks import before_and_after
from ppshw.diagnosis.columns import column_mistakes
from ppshw.diagnosis.evidence import Tried
from ppshw.diagnosis.fine_waves import fine_waves
from ppshw.diagnosis.found import LOST_MOTION, Found, by_its_own_form, moved_by, size_beyond
from ppshw.diagnosis.gross import GrossErrors, gross_errors, left_at_a_place, still_gross
from ppshw.diagnosis.jumps import jumps_of_reflectors, jumps_of_zeros
from ppshw.diagnosis.kinship import of_a_load
from ppshw.diagnosis.library import LOADS, Candidate, library
from ppshw.diagnosis.library.by_position import FineWave
from ppshw.diagnosis.library.weighing import as_weighed
from ppshw.diagnosis.nameless import nameless
from ppshw.diagnosis.parameters import BY_CAUSE, lost_by, of_one_wave
from ppshw.diagnosis.scatter import Scatter, scatter_of, scatter_without_a_name
from ppshw.diagnosis.search import search
from ppshw.diagnosis.serial import SerialNoise
from ppshw.diagnosis.visibility import visibility
from ppshw.diagnosis.wording import finding, history_of, stand_ins
from ppshw.diagnosis.workspace import Workspace, prepare
from ppshw.errors import RecordingError
from ppshw.free_memory import give_back
from ppshw.identification.joint import Estimate, estimate
from ppshw.identification.own_weight import fitted
from ppshw.identification.plausible import misread, without_gross_errors
from ppshw.identification.structure import joint_model
from ppshw.machine import Machine
from ppshw.recording import Recording
from ppshw.terms.shapes import named_column
from ppshw.terms.shapes.wrenches import beside_the_payload

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]
Mask = NDArray[np.bool_]
LEAST_VISITS = 40
MOST_LOOKS = 3
TAKEN = 4.0  # times as large as what the base model leaves of it
COLUMNS_PER_VISIT = 1 / 3  # of one candidate, at most
# Times the noise, rms: were half of a finding left by its form, visits would swing more by less than a hundredth.
# (Beside structure of a tenth of the noise scatter of a factor of 1.7 was not said; another author's 36063.)
LIKE_SCATTER = 0.25


@dataclass(frozen=True)
class Diagnosis:
    """answer: the contract's JSON; space and found: for whoever models or draws what was found."""

    answer: dict[str, Any]
    space: Workspace
    found: list[tuple[Found, Candidate]]


def diagnose(
    machine: Machine,
    recording: Recording,
    seed: int = 0,
    without: frozenset[str] = frozenset(),
    progress: Progress | None = None,
) -> Diagnosis:
    """What is missing in a recording: which joint, which effect, how large, and how much better the fit becomes.

    seed     of the random signs that the significance rests on
    without  effects that are taken out of the library (their cases must then be called unexplained)
    Raises RecordingError when the recording is too short to tell.
    """
    _refuse_too_few(recording)
    recording = _without_what_was_wanted(recording)
    wrong_loads = misread(machine, recording)
    odd, rows = np.flatnonzero(wrong_loads & recording.measured), np.flatnonzero(~wrong_loads)
    recording = recording.subset(rows)
    recording, mistakes = column_mistakes(machine, recording)
    tell = progress or (lambda done, total: None)
    tell(0, 10)
    space, gross, calming = _believed(machine, recording, without, seed)
    machine = space.machine
    tell(2, 10)
    # what goes with moves or loads may be an effect that looks like scatter; scatter may hide another effect
    tried, found = _look(space, without, seed, [], {}, [], lambda k: tell(2 + k, 10))
    if calming is not None and not found:
        del tried
        space = prepare(machine, recording, gross.others(recording), space.base, calming, gross.at_a_place)
        tried, found = _look(space, without, seed, [], {}, [], lambda k: tell(2 + k, 10))
    for again in range(MOST_LOOKS - 1):
        # strengths, noise and what is gross were learnt beside the effect; learn them again without it, and look once
        # more; and a third time where visits come back that only looked wrong
        riddles = [size_beyond(space, tried.candidates[f.best], f) for f in found if f.name[0] == "nameless"]
        still = still_gross(space, gross, max(riddles, default=0.0))
        if not found or (again and still.visits == gross.visits):
            break
        calming, gross, lost = _calming(space, without, seed), still, _lost(space, tried, found)
        before = _seen(tried, found)
        clean, shown = _without(space, tried, found), fine_waves(space)
        del tried  # its columns are most of the memory: the next look lays its own
        space = _learnt_without(machine, space, clean, gross, calming)
        tried, found = _look(space, without, seed, before, lost, shown, lambda k: tell(6 + k, 10))
    unnamed = "unsettled" in without
    # what a smooth function leaves of structure without a name swings more in places, and is no scatter
    large = _as_scatter(space, tried, found)
    riddle = any(f.name[0] == "nameless" for f in large)
    scatter = None if riddle else scatter_of(space, seed, True, unnamed, bool(large or gross.visits))
    give_back()
    # what acts through compliances is of its right size beside free ones, and predicts best beside those expected
    free = space.as_learnt(but_elastic=True) if any(f.name[0] in LOADS for f in found) else None
    space = space.as_learnt()
    wrong = [m.finding() for m in mistakes] + gross.findings(rows, odd)
    answer, carried = _answer(space, free or space, tried, found, gross, scatter, unnamed, wrong)
    del tried, free
    give_back()
    answer["provenance"] = {"machine_sha256": machine.sha256, "recording_sha256": recording.sha256}
    answer["visits"] += len(odd)
    answer["serial_correlation"] = SerialNoise.of(space).correlation(space, np.random.default_rng(seed))
    answer["checks"] = before_and_after(space, seed)
    tell(10, 10)
    return Diagnosis(answer, space, carried.found)


def _without_what_was_wanted(recording: Recording) -> Recording:
    """A corrected run's own columns cov_wanted_<joint> are its setpoints once more, and no covariate."""
    wanted = {f"wanted_{joint}" for joint in recording.joint_names}
    return replace(recording, covariates={k: v for k, v in recording.covariates.items() if k not in wanted})


def _refuse_too_few(recording: Recording) -> None:
    if (visits := int(recording.measured.sum())) < LEAST_VISITS:
        raise RecordingError(
            f"{recording.source}: visits with a target: {visits}, expected {LEAST_VISITS} or more to diagnose"
        )


def _believed(
    machine: Machine, recording: Recording, without: frozenset[str], seed: int
) -> tuple[Workspace, GrossErrors, Array | None]:
    """The base model of the visits that are not simply wrong, which ones are, and what calms the scatter there is."""
    everything = recording.measured
    near, surely = without_gross_errors(machine, recording)
    base = fitted(machine, near.subset(~surely & near.measured), near.subset(everything))
    machine = replace(machine, bent_by=base.model.machine.bent_by)
    space = prepare(machine, recording, everything, base)
    # what swings more than the rest counts less, or its visits would be called wrong
    calming = _calming(space.with_fit(everything & ~surely) if surely.any() else space, without, seed)
    calmed = space if calming is None else prepare(machine, recording, everything, space.base, calming)
    gross = gross_errors(calmed, surely)
    if gross.visits or gross.at_a_place:
        space = prepare(machine, recording, gross.others(recording), None, None, gross.at_a_place)
        # beside one that is metres off its neighbours looked wrong too
        if (still := still_gross(space, gross)).visits != gross.visits:
            gross = still
            space = prepare(machine, recording, gross.others(recording), None, None, gross.at_a_place)
    return space, gross, calming


def _learnt_without(
    machine: Machine, space: Workspace, clean: Recording, gross: GrossErrors, calming: Array | None
) -> Workspace:
    """The base model once more, learnt from the recording as it would be without what was found (clean)."""
    believed = gross.others(space.recording)
    believable = clean.subset(believed)
    base = estimate(joint_model(machine, believable), believable)
    base = _as_believed(space, base, believed)
    return prepare(machine, space.recording, believed, base, calming, gross.at_a_place)


def _calming(space: Workspace, without: frozenset[str], seed: int) -> Array | None:
    found = scatter_of(space, seed, nameless="unsettled" in without)
    return None if found is None else found.calming


def _look(
    space: Workspace, without: frozenset[str], seed: int, before: list[Candidate], lost: Mapping[str, float],
    shown: list[FineWave], tell: Callable[[int], None],
) -> tuple[Tried, list[Found]]:  # fmt: skip
    """before: what an earlier look found, whose moments, periods, bands of waves, loads and creep are tried more
    finely; lost: what joints lose by it; shown: fine waves that were left beside it."""
    moments = [k.shape["time_h"] for k in before if "time_h" in k.shape]
    periods = [(str(k.joint), k.shape["period"]) for k in before if "period" in k.shape]
    bands = [k for k in before if k.effect == "nameless" and all(column.function == "wave" for column in k.columns)]
    give_back()
    jumps = jumps_of_zeros(space)
    knocks = [] if "target_moved" in without else jumps_of_reflectors(space)
    # so many columns would fit anything that few visits say
    most = COLUMNS_PER_VISIT * int(space.fit.sum())
    loads = {load for k in before if (load := of_a_load(k)) is not None}
    creeps = any(k.effect == "creep" for k in before)
    waves = list(dict.fromkeys([*shown, *fine_waves(space)]))
    every = library(space.context, without, moments, periods, bands, jumps, knocks, lost, loads, creeps, waves)
    every = [k for k in every if most >= len(k.columns)]
    named = as_weighed(space.context, every)
    kept, unnamed = {id(k) for k in named}, waves if "periodic_transmission" in without else []
    candidates = named + [k for k in nameless(space.context, jumps, unnamed, without) if most >= len(k.columns)]
    give_back()
    tried = Tried(space, candidates, space.unit, without, [k for k in every if id(k) not in kept])
    tell(2)
    earlier = [(k.effect, k.joint) for k in before if k.effect != "nameless"]
    found = search(space, tried, np.random.default_rng(seed), earlier)
    tell(4)
    return tried, found


def _seen(tried: Tried, found: Sequence[Found]) -> list[Candidate]:
    """What an earlier look found, to look there more finely: of a name that was given up its form, and the structure
    that stands in its place (a wave across a travel beside one along it was a band without a name, and was asked for
    along it alone; another author's 56035)."""
    each = dict.fromkeys(k for f in found if not f.read for k in (f.was, f.best) if k is not None)
    return [tried.candidates[k] for k in each]


def _lost(space: Workspace, tried: Tried, found: list[Found]) -> dict[str, float]:
    """What joints lose when they turn back, along or about their own axes [m or rad]."""
    out: dict[str, float] = {}
    for f in found:
        if f.name[0] in LOST_MOTION:
            form = tried.candidates[f.best]
            lost = 2.0 * abs(lost_by(form, by_its_own_form(space, form, f)[0]))
            out[str(f.name[1])] = max(lost, out.get(str(f.name[1]), 0.0))
    return out


def _as_believed(space: Workspace, base: Estimate, believed: Mask) -> Estimate:
    """An estimate for the believed visits (N,) that trusts none of them less than before: what looks odd to it may be
    what the effect's form left, where it bends more than the form can. A visit that comes back is believed in full."""
    before = np.ones(len(believed))
    before[space.fit] = space.base.weights
    return replace(base, weights=np.maximum(base.weights, before[believed]))


def _without(space: Workspace, tried: Tried, found: Sequence[Found]) -> Recording:
    """The recording as it would be without what was found. What the base model would take nearly all of is known by
    what is left alone: where a dead mass of 0.1 mm was said to be one of 0.8, compliances were learnt wrong without it
    (another author's 21087). What the sensor surely misreads is known by its readings, and taken off these: compliances
    that were learnt with them make up for most of it."""
    moved, base, wrench = np.zeros_like(space.data), space.as_estimated(), space.recording.wrench
    for f in found:
        if tried.candidates[f.best].columns[0].function == "weighed":
            wrench = space.recording.wrench - beside_the_payload(space.context)
            continue
        whole = moved_by(space, tried.candidates[f.best], f)
        left = base.beyond(whole)
        moved += left if TAKEN * np.linalg.norm(left) < np.linalg.norm(whole) else whole
    shift = moved.reshape(space.recording.points.shape)
    points = space.recording.points - shift @ space.base.measuring_in_base[:3, :3]
    return replace(space.recording, points=points, wrench=wrench)


def _answer(
    space: Workspace,
    free: Workspace,
    tried: Tried,
    found: list[Found],
    gross: GrossErrors,
    scatter: Scatter | None,
    unnamed: bool,
    wrong: list[dict[str, Any]],
) -> tuple[dict[str, Any], Carried]:
    """free: as what was found is to be described; unnamed: whether scatter has no name; wrong: findings of columns and
    visits that are."""
    named = [f for f in found if f.name[0] != "nameless"]
    left = [f for f in found if f.name[0] == "nameless"]
    findings = wrong + [finding(free, tried, f, more) for f, more in _each_once(tried, named)]
    unexplained = left_at_a_place(space, gross)
    if scatter is not None and not unnamed:
        findings.append(scatter.finding)
    elif scatter is not None and unexplained is None:
        unexplained = scatter_without_a_name(space, scatter)
    if left:
        unexplained = _unexplained(free, tried, left)
    carried = carry(space, tried, found)
    answer = {
        "visits": int(space.recording.measured.sum()),
        # noise was learnt beside what a smooth function left of structure without a name; held-out visits had it too
        "noise_floor_mm": min(_noise_floor(space), carried.after) if carried.corrections else _noise_floor(space),
        "verdict": "unexplained" if unexplained is not None else "missing_physics" if findings else "consistent",
        "findings": findings,
        "unexplained": unexplained,
        "visibility": visibility(tried),
        "corrections": carried.corrections,
        "held_out": {"rms_before_mm": carried.before, "rms_after_mm": carried.after},
    }
    return answer, carried


def _each_once(tried: Tried, found: list[Found]) -> list[tuple[Found, list[Found]]]:
    """One finding per effect and joint, with its further pieces: what was taken up later under the same name there
    mends its form, but for another reflector, another joint that a coupling goes with, and a wave of another period."""
    kept: list[tuple[Found, list[Found]]] = []
    for f in found:
        mine = tried.candidates[f.best]
        for g, more in kept:
            other = tried.candidates[g.best]
            apart = f.name[0] in BY_CAUSE and other.covariate != mine.covariate
            if g.name == f.name and not apart and of_one_wave(other.shape.get("period"), mine.shape.get("period")):
                more.append(f)
                break
        else:
            kept.append((f, []))
    return kept


def _as_scatter(space: Workspace, tried: Tried, found: Sequence[Found]) -> list[Found]:
    """Findings large enough for what their forms leave to look like scatter."""
    least = LIKE_SCATTER * 1e-3 * _noise_floor(space)
    return [f for f in found if size_beyond(space, tried.candidates[f.best], f) > least]


def _noise_floor(space: Workspace) -> float:
    """rms of a reading by noise alone [mm]: pose repeatability and instrument, as identified."""
    covariance = np.linalg.inv(np.swapaxes(space.root, 1, 2) @ space.root + 1e-6 * np.eye(space.rows))
    seen = np.repeat(space.recording.seen, 3, axis=1) & space.fit[:, None]
    variance = np.einsum("nii->ni", covariance)[seen]
    return float(np.sqrt(3 * variance.mean()) * 1e3)


def _unexplained(space: Workspace, tried: Tried, left: list[Found]) -> dict[str, Any]:
    """Of what has no name the loudest; its size is that of all over its columns together, which may go against each
    other, beyond what the base model would take of them."""
    f = max(left, key=lambda f: f.evidence)
    candidate = tried.candidates[f.best]
    alike = [g for g in left if tried.candidates[g.best].covariates == candidate.covariates]
    moved = np.sum([moved_by(space, tried.candidates[g.best], g) for g in alike], axis=0)
    said = stand_ins(space.context, candidate)[:2]
    region = {}
    for column, _ in said:
        values = named_column(space.context, column)
        region[column] = [float(np.nanmin(values)), float(np.nanmax(values))]
    said += [(name, f"times {name}") for name in candidate.covariates[2:]]
    return {
        "covariates": list(region),
        "history": history_of(said),
        "frame": candidate.frame,
        "component": candidate.component,
        "region": region,
        "rms_mm": 1e3 * space.rms(space.beyond(moved)),
        "p_value": f.p,
    }
