"""One concealed case, opened and scored: was it found, named and located; what could have been found; what was gained.

The bound. The true effect moves the reflectors by a field f, known from the opened seal. With the true covariance of
the noise whitened away and the base model's parameters free within their priors,

    λ = fᵀ (Σ + X Λ Xᵀ)⁻¹ f          X (N·3T, p) design of the base model, Λ its prior variances, Σ the noise

is the noncentrality that is left for a test of exactly this form; with Λ → ∞ it becomes the projection's, given beside
it. An F test of the true form, one degree of freedom, family-wise over CLASSES names, then has the power

    P(F'(1, ν; λ) > F(1, ν)₁₋α),     α = 0.05 / CLASSES                    docs/prove.md

Nobody who does not know the form beforehand can do better.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.stats import f as f_distribution
from scipy.stats import ncf

from ppshw.calibration import Calibration, load_calibration
from ppshw.diagnosis.evidence import Name
from ppshw.diagnosis.library import library
from ppshw.errors import BadInput, SealBroken
from ppshw.evaluation import figures, residuals
from ppshw.identification import identify
from ppshw.identification.joint import Estimate
from ppshw.kinematics import frames, point_jacobian, point_positions
from ppshw.machine import Machine, load_machine
from ppshw.recording import Recording, load_recording
from ppshw.terms import Situation
from ppshw.terms.shapes import Column, Context, Key

Array = NDArray[np.float64]
CLASSES = 35  # names that compete for a finding: the effects, times the joints they may sit in, roughly
ATTAINABLE = 0.02  # below it, the share that was realised of an improvement is a share of nothing
MOST_FORMS = 40  # of each of several names
NOISE_EFFECTS = ("outliers", "unsettled")  # scatter, not bias: the bound does not apply
Json = dict[str, Any]


def open_seal(published: str, sealed: Path) -> Json:
    """The truth, if it still is the one whose hash was published. Raises SealBroken when it is not, or is gone."""
    try:
        text = (sealed / "truth.json").read_bytes()
    except OSError as exc:
        raise SealBroken(f"{sealed / 'truth.json'}: {exc.strerror or exc}") from None
    found = hashlib.sha256(text).hexdigest()
    if found != published:
        raise SealBroken(f"{sealed / 'truth.json'}: hash {found[:12]}, but {published[:12]} was published")
    truth: Json = json.loads(text)
    return truth


def score_case(
    case: Path, sealed: Path, published: str, answer: Json, calibration: Path | None, seconds: float
) -> Json:  # fmt: skip
    """Everything the table wants to know of one case.

    published    the truth's hash, from before the diagnosis; what lies in the case's folder it could have changed
    answer       what `diagnose` said (contract §4)
    calibration  the extended calibration that it wrote, where it did
    """
    truth = open_seal(published, sealed)
    machine = load_machine(case / "machine.yaml")
    recording = load_recording(case / "recording.csv", machine)
    held_out = case / "held_out.csv"
    later = load_recording(held_out, machine) if held_out.exists() else None
    fields = [1e-9 * np.array(e["field_nm"], dtype=float) for e in truth["effects"]]
    base = identify(machine, recording)
    strengths = [bound(machine, recording, base, field[: len(recording)], truth) for field in fields]
    told = [{k: v for k, v in e.items() if k != "field_nm"} for e in truth["effects"]]
    for e, strength in zip(told, strengths, strict=True):
        e.update(strength if e["effect"] not in NOISE_EFFECTS else dict.fromkeys(strength))
    predictable = not any(e["effect"] in NOISE_EFFECTS for e in told)
    judged = judge(told, answer)
    left = None
    if predictable and told and (judged["wrong"] or not all(judged["named"])):
        shown = [field[: len(recording)] for field in fields]
        left = left_by_answer(machine, recording, base, shown, truth, answer, judged)
    gained = None
    if later is not None and predictable:
        gained = held_out_gain(machine, recording, later, base, fields, calibration)
    return {**score_of(truth, told, answer, gained, seconds), "visits": len(recording), "sqrt_lambda_left": left}


def score_of(truth: Json, told: Sequence[Json], answer: Json, gained: Json | None, seconds: float) -> Json:
    """What the table reads: case, effects with their strengths, the answer and how right it was, gain and time."""
    return {
        **{k: truth[k] for k in ("seed", "machine", "asked", "size", "repeatability_rms_mm")},
        "truth": told,
        "answer": answer,
        **judge(told, answer),
        "held_out": gained,
        "seconds": round(seconds, 2),
    }


# --- was it right? ------------------------------------------------------------------------------------------------
def judge(truth: Sequence[Json], answer: Json) -> Json:
    """Compare what was said with what there was.

    returns per true effect (a list each, in the truth's order)
        named       a finding has its name
        joint_right and its joint, and none has the joint of nothing true by that name; None where it was not named
        in_aliases  a finding, one of its alternatives, or one of its aliases (what the recording cannot tell it from)
                    has its name
        located     the joint or one of the columns it depends on was pointed at, whatever the name
    and of the whole
        detected    something was found;          false_alarm   although there was nothing
        wrong       names that nothing true bears, not even a fair neighbour
        wrong_apart those of them that say of nothing true that it is their alias
        unknown_ok  all that no catalogue holds was called unexplained, or by a fair neighbour's name; None without such
        weights     [weight, was it right] of every name offered
    """
    findings = list(answer.get("findings") or [])
    unexplained = answer.get("unexplained")
    names = {e["effect"] for e in truth}
    fair = names.union(*(e["neighbours"] for e in truth)) if truth else set()
    strangers = [e for e in truth if not e["known"]]
    named, joint_right, in_aliases = [], [], []
    for e in truth:
        mine = [f for f in findings if f["effect"] == e["effect"]]
        offered = [a for f in findings for a in (f, *(f.get("alternatives") or []), *(f.get("aliases") or []))]
        named.append(bool(mine))
        theirs = [t for t in truth if t["effect"] == e["effect"]]
        right = any(_joint_agrees(e, f) for f in mine) and all(any(_joint_agrees(t, f) for t in theirs) for f in mine)
        joint_right.append(right if mine else None)
        in_aliases.append(any(a["effect"] == e["effect"] for a in offered))
    wrong = [f for f in findings if f["effect"] not in fair]
    apart = [f for f in wrong if names.isdisjoint(a["effect"] for a in f.get("aliases") or [])]
    detected = bool(findings) or unexplained is not None or answer["verdict"] != "consistent"
    return {
        "verdict": answer["verdict"],
        "detected": detected,
        "false_alarm": not truth and detected,
        "named": named,
        "joint_right": joint_right,
        "in_aliases": in_aliases,
        "located": [_located(e, findings, unexplained) for e in truth],
        "wrong": sorted({f["effect"] for f in wrong}),
        "wrong_apart": sorted({f["effect"] for f in apart}),
        "unknown_ok": all(_unknown_ok(e, findings, answer) for e in strangers) if strangers else None,
        "weights": _weights(truth, findings),
    }


def _joint_agrees(e: Json, finding: Mapping[str, Any]) -> bool:
    """Effects that belong to no joint want null, or the joint that the truth calls a fair answer."""
    said = finding.get("joint")
    return bool(said == e["joint"] or said in e["also"])


def _located(e: Json, findings: Sequence[Mapping[str, Any]], unexplained: Mapping[str, Any] | None) -> bool:
    joints = {e["joint"], *e["also"]} - {None}
    columns = set(e["covariates"]) | {f"q_{j}" for j in joints} | {f"approach_{j}" for j in joints}
    if unexplained:
        before = "before" in str(unexplained.get("history")) or "last move" in str(unexplained.get("history"))
        if columns & set(unexplained.get("covariates") or ()) or ("previous_pose" in columns and before):
            return True
    return any(f.get("joint") in joints or f.get("covariate") in columns for f in findings)


def _unknown_ok(e: Json, findings: Sequence[Mapping[str, Any]], answer: Json) -> bool:
    neighbour = any(f["effect"] in e["neighbours"] for f in findings)
    return answer.get("unexplained") is not None or answer["verdict"] == "unexplained" or neighbour


def _weights(truth: Sequence[Json], findings: Sequence[Mapping[str, Any]]) -> list[list[float | bool]]:
    """Every name that was offered, its weight and whether it is right: "nameless" of what no catalogue has."""
    out: list[list[float | bool]] = []
    strange = any(not e["known"] for e in truth)
    for f in findings:
        for offered in (f, *(f.get("alternatives") or [])):
            right = any(e["effect"] == offered["effect"] and _joint_agrees(e, offered) for e in truth)
            right |= strange and offered["effect"] == "nameless"
            if offered.get("weight") is not None:
                out.append([float(offered["weight"]), right])
    return out


# --- what could have been found -----------------------------------------------------------------------------------
@dataclass(frozen=True)
class _White:
    """Design (R, p) and field (R,) of all readings, the true noise whitened to one; prior (p,) standard deviations;
    lower (N, 3T, 3T) that the noise is divided by."""

    lower: Array
    design: Array
    field: Array
    prior: Array


def bound(machine: Machine, recording: Recording, base: Estimate, field: Array, truth: Json) -> Json:
    """How strongly the recording shows the true form once the base model has had its share.

    field    (N, T, 3) how the effect moves the reflectors [m]
    returns  sqrt_lambda, sqrt_lambda_free (no priors), share_visible (of fᵀΣ⁻¹f), power
    """
    white = _whiten(machine, recording, base, field, truth)
    gram, moment = white.design.T @ white.design, white.design.T @ white.field
    power = float(white.field @ white.field)
    # fᵀ(I + XΛXᵀ)⁻¹f = fᵀf − fᵀX(Λ⁻¹ + XᵀX)⁻¹Xᵀf, in parameters scaled by their priors
    scaled = white.prior[:, None] * gram * white.prior
    scaled[np.diag_indices_from(scaled)] += 1.0
    along = white.prior * moment
    left = power - float(along @ cho_solve(cho_factor(scaled), along))
    length = np.linalg.norm(white.design, axis=0)
    unit = white.design / np.where(length > 0, length, 1.0)
    rest = white.field - unit @ np.linalg.lstsq(unit, white.field, rcond=1e-9)[0]
    freedom = max(1.0, white.field.size - float(np.trace(np.linalg.solve(scaled, scaled - np.eye(len(scaled))))))
    strength = max(0.0, left)
    critical = f_distribution.isf(0.05 / CLASSES, 1, freedom)
    return {
        "sqrt_lambda": float(np.sqrt(strength)),
        "sqrt_lambda_free": float(np.linalg.norm(rest)),
        "share_visible": strength / power if power > 0 else 0.0,
        "power": float(ncf.sf(critical, 1, freedom, strength)),
    }


def least_left(
    machine: Machine, recording: Recording, base: Estimate, field: Array, truth: Json, names: Collection[Name],
    known: Sequence[Array] = (),
) -> float | None:  # fmt: skip
    """The least √λ, as in `bound`, that a true field leaves beside one form of the library's grid of each of these
    effects at these joints, coefficients free: below half power's 3.2 nobody could have told them from the truth by
    this recording. √λ itself beside no name; None where the library has no form of one of them.

    Of several names, the MOST_FORMS of each are tried together that leave least by themselves: what is left is no more.

    field  (N, T, 3) how true effects move the reflectors [m];  known  the same of others, which are there in any case
    """
    white = _whiten(machine, recording, base, field, truth)
    context = Context.of(base.model, base.theta, recording, base.measuring_in_base)
    forms: dict[Name, list[list[int]]] = {name: [] for name in names}
    place: dict[Key, int] = {}
    columns: list[Column] = []
    for candidate in library(context) if names else ():
        if (candidate.effect, candidate.joint) in forms:
            columns += [column for column in candidate.columns if column.key not in place]
            which = [place.setdefault(column.key, 1 + len(known) + len(place)) for column in candidate.columns]
            forms[candidate.effect, candidate.joint].append(which)
    if not all(forms.values()):
        return None
    laid = [np.linalg.solve(white.lower, k.evaluate(context)[..., None]).reshape(-1) for k in columns]
    others = [np.linalg.solve(white.lower, k.reshape(len(k), -1, 1)).reshape(-1) for k in known]
    both = np.column_stack([white.field, *others, *laid])
    both[:, 1:] /= np.maximum(np.linalg.norm(both[:, 1:], axis=0), 1e-30)
    # scores and information of the field and all columns, base free within its priors
    scaled = white.design * white.prior
    information = scaled.T @ scaled
    information[np.diag_indices_from(information)] += 1.0
    taken = solve_triangular(np.linalg.cholesky(information), scaled.T @ both, lower=True)
    matrix = both.T @ both - taken.T @ taken

    def left(some: Sequence[int]) -> float:
        which = [*range(1, 1 + len(known)), *some]
        score, among = matrix[0, which], matrix[np.ix_(which, which)]
        fitted = np.linalg.lstsq(among, score, rcond=1e-9)[0]
        return math.sqrt(max(0.0, float(matrix[0, 0] - score @ fitted)))

    tried = list(forms.values())
    if len(tried) > 1:
        tried = [sorted(each, key=left)[:MOST_FORMS] for each in tried]
    return min(left(list(itertools.chain.from_iterable(one))) for one in itertools.product(*tried))


def left_by_answer(
    machine: Machine, recording: Recording, base: Estimate, fields: Sequence[Array], truth: Json, answer: Json,
    judged: Json,
) -> float | None:  # fmt: skip
    """What an answer that is amiss leaves of the truth, `least_left`: all of it beside one form of every name given, or
    what has no name there beside what has and one form of every wrong name; the less of the two. Scatter moves nothing
    and leaves it all."""
    given = {(f["effect"], f["joint"]) for f in answer["findings"] if f["effect"] not in NOISE_EFFECTS}
    out = [least_left(machine, recording, base, np.sum(fields, axis=0), truth, given)]
    missed = [field for field, named in zip(fields, judged["named"], strict=True) if not named]
    if missed:
        known = [field for field, named in zip(fields, judged["named"], strict=True) if named]
        wrong = {name for name in given if name[0] in judged["wrong"]}
        out.append(least_left(machine, recording, base, np.sum(missed, axis=0), truth, wrong, known))
    return min((one for one in out if one is not None), default=None)


def _whiten(machine: Machine, recording: Recording, base: Estimate, field: Array, truth: Json) -> _White:
    """The noise as it was drawn: every link's scatter through the nominal Jacobian, and the instrument's."""
    situation, seen = Situation.of(recording), recording.seen
    chain = frames(machine, recording.q)
    where = point_positions(machine, recording.q, machine.target_array)
    jacobian = point_jacobian(chain, where)[:, :, :, 1:]  # (N, T, 3, n, 6)
    loose = jacobian * np.array(truth["scatter"])
    count, width = len(recording), 3 * seen.shape[1]
    loose = loose.reshape(count, width, -1)
    covariance = loose @ np.swapaxes(loose, 1, 2) + truth["instrument_sigma"] ** 2 * np.eye(width)
    lower = np.linalg.cholesky(covariance)
    design = base.model.linearise(situation, base.theta).design.reshape(count, width, -1)
    both = np.concatenate([design, field.reshape(count, width, 1)], axis=2)
    white = np.linalg.solve(lower, both).reshape(count * width, -1)
    prior = np.array([p.scale * base.groups[p.group] for p in base.model.parameters()])
    return _White(lower, white[:, :-1], white[:, -1], prior)


# --- what was gained ----------------------------------------------------------------------------------------------
def held_out_gain(
    machine: Machine,
    recording: Recording,
    later: Recording,
    base: Estimate,
    fields: Sequence[Array],
    calibration: Path | None,
) -> Json:
    """Residual on visits that no fit saw [mm rms]: base model, extended one, and a base model that was told the truth.

    The last has the true displacement taken away from both recordings before it was fitted and evaluated: nobody can
    know the effect better. realised = (before − after) / (before − told), 0 for a diagnosis that left no calibration
    and None where less than ATTAINABLE of `before` is to be had.
    """
    before = figures(residuals(later, Calibration.of(base, recording, "joint")))["rms_mm"]
    told = before
    if fields:
        whole = np.sum(fields, axis=0)
        clean = replace(recording, points=recording.points - whole[: len(recording)])
        clean_later = replace(later, points=later.points - whole[len(recording) :])
        best = Calibration.of(identify(machine, clean), clean, "joint")
        told = figures(residuals(clean_later, best))["rms_mm"]
    after = before
    if calibration is not None and calibration.exists():
        after = figures(residuals(later, load_calibration(calibration, machine)))["rms_mm"]
    attainable = before - told
    realised = (before - after) / attainable if attainable > ATTAINABLE * before else None
    return {"rms_before_mm": before, "rms_after_mm": after, "rms_true_form_mm": told, "realised": realised}


def read_answer(path: Path) -> Json:
    """What a diagnosis wrote. Raises BadInput when it is not the contract's answer."""
    try:
        answer: Json = json.loads(path.read_text(encoding="utf-8"))
        missing = {"verdict", "findings"} - set(answer)
    except (OSError, ValueError, TypeError) as problem:
        raise BadInput(f"{path}: no answer of a diagnosis ({problem})") from None
    if missing:
        raise BadInput(f"{path}: no {' and no '.join(sorted(missing))} in the answer, expected the contract's keys")
    return answer
