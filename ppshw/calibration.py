"""What was identified: values, uncertainty, where it is valid, and where it came from.

One JSON file that a person can read: every parameter with name, value, standard deviation and unit. It is refused for
another machine than the one it was made for.
"""

from __future__ import annotations

import hashlib
import json
import zlib
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from ppshw import __version__
from ppshw.errors import CalibrationError, RecordingError
from ppshw.identification.joint import Estimate, believable
from ppshw.identification.noise import Noise
from ppshw.identification.plausible import loads_not_measured, rests_off, sides_seen
from ppshw.machine import WRENCH_COMPONENTS, BentBy, Machine
from ppshw.model import Model
from ppshw.packed import packed, unpacked
from ppshw.recording import Recording
from ppshw.terms import FrameTerm, earlier
from ppshw.terms.effect import Effect
from ppshw.terms.elastic import Compliance
from ppshw.terms.geometric import Geometric
from ppshw.terms.own_motion import OwnMotion
from ppshw.terms.target import TargetOffset
from ppshw.transforms import spans_a_frame
from ppshw.whole_file import write_text

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
FORMAT = "ppshw calibration 1"
# Sampled positions that are listed in full; a random campaign has one per visit and says so by its range.
MOST_POSITIONS = 200
# Beyond the ends of what was identified this is let pass: a share of the range, and what readings scatter by.
RANGE_MARGIN = 0.02
SLACK_JOINT, SLACK_FORCE, SLACK_MOMENT = 1e-6, 5.0, 2.0  # [m or rad], [N], [N m]
# Metres, radians, newtons and what is made of them stay far below; beyond, squares would overflow.
LARGEST = 1e9


@dataclass(frozen=True)
class Identified:
    """Between which values a joint or a load component was identified [unit], and how far beyond is let pass."""

    name: str
    unit: str
    low: float
    high: float
    slack: float

    def is_outside(self, values: Array) -> Mask:
        """What is no number is outside too."""
        return np.logical_not((values >= self.low - self.slack) & (values <= self.high + self.slack))


@dataclass(frozen=True)
class Calibration:
    """A model with its parameters.

    theta, covariance   (p,), (p, p)
    measuring_in_base   (4, 4) where the instrument stood
    joint_range         (n, 2) what was sampled of every joint                 [m, rad]
    payload_range       (6, 2) what was sampled of the payload, sensor frame   [N, N·m]
    provenance          method, hashes, version, date, counts
    effects, reference  what a diagnosis found beyond model (17), and the figures its functions refer to
    laid                (p,) parameters that these functions were made with: what creeps is what links gave way by then,
                        whatever they are found to give way by beside it; None: as `theta`
    alone               (p,) what the variance of a single parameter is more than by `covariance`; None: nothing
    strengths           prior standard deviation of every group of parameters, as learnt; empty where none was
    ambiguous           what the recording does not tell apart, as `ambiguity.Ambiguity.as_dict` says it
    temperature_range   place → least and greatest seen; what has no reading there is not listed   [°C]
    visits              what effects may remember: the recording's visits, without their readings; None without effects
    """

    model: Model
    theta: Array
    covariance: Array
    noise: Noise
    measuring_in_base: Array
    joint_range: Array
    payload_range: Array
    sampled: dict[str, list[float]]
    provenance: dict[str, Any]
    effects: tuple[Effect, ...] = ()
    reference: dict[str, float] = field(default_factory=dict)
    strengths: dict[str, float] = field(default_factory=dict)
    ambiguous: tuple[dict[str, Any], ...] = ()
    visits: Recording | None = None
    temperature_range: dict[str, tuple[float, float]] = field(default_factory=dict)
    laid: Array | None = None
    alone: Array | None = None

    @property
    def std(self) -> Array:
        """(p,) standard deviation of every parameter by itself, as the file states it."""
        return np.asarray(np.sqrt(np.diag(self.covariance) + (0.0 if self.alone is None else self.alone)))

    @property
    def laid_at(self) -> Array:
        return self.theta if self.laid is None else self.laid

    @property
    def machine(self) -> Machine:
        return self.model.machine

    def doubts(self) -> list[str]:
        """What whoever moves axes by it should know, each in a line."""
        said = []
        if loads := self.provenance.get("loads_not_measured"):
            said.append(
                f"its recording had loads ({loads}) and no wrench of them: a setpoint is for an average of them, and "
                "its std_mm knows nothing of what they do"
            )
        for joint, far in self.provenance.get("rests_off", {}).items():
            said.append(
                f"{joint} rested {far} from where it was sent while it was measured: a setpoint is where its encoder "
                "should stand, and std_mm knows nothing of that"
            )
        for mended in self.provenance.get("columns_set_right", ()):
            said.append(
                f"it is of its recording set right ({mended}): what still reads so, as the force sensor, must be set "
                "right too"
            )
        tracker = self.machine.tracker
        if tracker.base is None:
            said.append(
                "where the tracker stood was estimated: poses are right relative to each other"
                f"{'' if tracker.targets_known else ' but for what the end effector is off'}; where the base frame is, "
                "which std_mm does not hold, is known no better than the machine was built"
            )
        if not tracker.targets_known:
            said.append(
                "where the reflectors sit was estimated: what the end effector is off at every pose alike, of which "
                "std_mm holds a part, is known no better than it was built"
            )
        return said + self._reflectors_wanting()

    def _reflectors_wanting(self) -> list[str]:
        """What the reflectors that were read cannot say."""
        targets = self.machine.targets
        read = [name for name in self.provenance.get("reflectors_read", targets) if name in targets]
        said = []
        if read and not spans_a_frame(np.array([targets[name] for name in read])):
            only = "its only reflector" if len(targets) == 1 else "the only reflector that was read"
            which = (
                f"the reflectors that were read ({', '.join(read)}) lie on a line"
                if read[1:]
                else f"{read[0]} is {only}"
            )
            said.append(
                f"{which}: how the end effector turns about it no reading says, so that std_mm of points away from it "
                "rests on what machines are like"
            )
        if not self.machine.tracker.targets_known and (never := [name for name in targets if name not in read]):
            said.append(f"{', '.join(never)} {'was' if len(never) == 1 else 'were'} never read: taken to sit as built")
        return said

    def point(self, name: str) -> Array:
        """(3,) a named point in the end-effector frame: a target where it was identified to be, another one where the
        machine file has it. Raises MachineFileError where there is no such point."""
        target = self.target_index(name)
        return self.machine.point(name) if target is None else np.asarray(self.model.targets(self.theta)[target])

    def target_index(self, name: str) -> int | None:
        """Which of the machine's targets a named point is; None where it is another point."""
        machine = self.machine
        known = name not in machine.points and name in machine.targets
        return list(machine.targets).index(name) if known else None

    def other_sides(self, approach: NDArray[Any]) -> list[str]:
        """A line for each joint that comes, by the sign of `approach` (n,), from another side than it was ever measured
        from, or from a side that nobody knows: what it loses when it turns back no recording says."""
        known = dict(zip(self.machine.joint_names, np.sign(approach).tolist(), strict=True))
        return [
            f"{joint} was measured coming in its {'+' if side > 0 else '−'} direction alone, "
            f"{'and may come' if known[joint] == 0 else 'and comes'} in the other here: what it loses when it turns "
            "back is not known"
            for joint, side in self.provenance.get("one_side", {}).items() if known.get(joint, side) != side
        ]  # fmt: skip

    def identified_joints(self, margin: float = RANGE_MARGIN) -> list[Identified]:
        """Per joint, in the chain's order; margin: share of the range that is let pass beyond its ends."""
        return [Identified(j.name, j.unit, low, high, margin * (high - low) + SLACK_JOINT)
                for j, (low, high) in zip(self.machine.joints, self.joint_range.tolist(), strict=True)]  # fmt: skip

    def identified_loads(self, margin: float = RANGE_MARGIN) -> list[Identified]:
        """Per component of the payload on the sensor, margin as for joints."""
        units, slacks = np.repeat(["N", "N m"], 3).tolist(), np.repeat([SLACK_FORCE, SLACK_MOMENT], 3).tolist()
        return [Identified(name, unit, low, high, margin * (high - low) + slack) for name, unit, slack, (low, high)
                in zip(WRENCH_COMPONENTS, units, slacks, self.payload_range.tolist(), strict=True)]  # fmt: skip

    def outside(
        self, q: Array, payload: Array, joints: float = RANGE_MARGIN, loads: float = RANGE_MARGIN
    ) -> list[str]:  # fmt: skip
        """What of joint values (n,) and a payload (6,) lies farther outside what was identified than these shares of
        its range, each in words: joints first, then loads, the farthest first (a moment as a force on a lever of a
        metre)."""
        of_joints = zip(self.identified_joints(joints), q.tolist(), strict=True)
        of_loads = zip(self.identified_loads(loads), payload.tolist(), strict=True)
        far = [(f"joint '{each.name}' at", each, value) for each, value in of_joints if each.is_outside(value)]
        beyond = [(f"load {each.name} =", each, value) for each, value in of_loads if each.is_outside(value)]
        far += sorted(beyond, key=lambda one: min(one[2] - one[1].low, one[1].high - one[2]))
        return [
            f"{what} {value:.6g} {each.unit} is outside what was identified, {each.low:.6g} … {each.high:.6g}"
            for what, each, value in far
        ]

    def continued(self, recording: Recording) -> tuple[Recording, Mask]:
        """A recording with what this calibration knows of the visits before and between its own, and which rows are
        its own (N,): `earlier.continued`. That which the calibration was made from stands for itself.

        Raises RecordingError where it lacks a temperature, or another column, by which one of the effects goes."""
        none = np.array(np.nan)
        places = dict.fromkeys(place for effect in self.effects for place in effect.places)
        needed = {f"temp_{place}_C": recording.temperatures.get(place, none) for place in places}
        needed |= {
            name: recording.covariates.get(name.removeprefix("cov_"), none)
            for effect in self.effects for name in effect.over
        }  # fmt: skip
        for column, values in needed.items():
            if not np.isfinite(values).all():
                raise RecordingError(
                    f"{recording.source}: column {column} is missing or empty, by which an effect of the "
                    "calibration goes"
                )
        own = recording.sha256 == self.provenance.get("recording_sha256")
        return earlier.continued(None if own else self.visits, recording)

    def fitted(self, recording: Recording) -> int:
        """How many visits of a recording are, by their times, among those it was made from, as far as it keeps them."""
        return 0 if self.visits is None else int(earlier.shared(self.visits, recording).sum())

    @classmethod
    def of(cls, estimate: Estimate, recording: Recording, method: str, now: datetime | None = None) -> Calibration:
        """From an estimate of a recording; visits that were set aside or saw no target do not widen the valid range."""
        used = recording.subset(believable(estimate.weights))
        machine = estimate.model.machine
        provenance = {
            "method": method,
            "machine_name": machine.name,
            "machine_sha256": machine.sha256,
            "recording": Path(recording.source).name,
            "recording_sha256": recording.sha256,
            "visits": len(recording),
            "visits_used": len(used),
            "readings": int(recording.seen.sum()),
            "visits_down_weighted": int(recording.measured.sum()) - len(used),
            "ppshw": __version__,
            "date": (now or datetime.now(UTC)).isoformat(timespec="seconds"),
        }
        provenance["reflectors_read"] = [name for k, name in enumerate(machine.targets) if used.seen[:, k].any()]
        if loads := loads_not_measured(recording):
            provenance["loads_not_measured"] = loads
        if off := rests_off(machine, recording):
            provenance["rests_off"] = off
        if sides := sides_seen(recording):
            provenance["one_side"] = sides
        sampled = {}
        for k, name in enumerate(machine.joint_names):
            positions = np.unique(np.round(used.q[:, k], 4))
            sampled[name] = positions.tolist() if len(positions) <= MOST_POSITIONS else [positions[0], positions[-1]]
        return cls(
            estimate.model,
            estimate.theta,
            estimate.covariance,
            estimate.noise,
            estimate.measuring_in_base,
            np.stack([used.q.min(axis=0), used.q.max(axis=0)], axis=1),
            np.stack([used.wrench.min(axis=0), used.wrench.max(axis=0)], axis=1),
            sampled,
            provenance,
            strengths=dict(estimate.groups),
            temperature_range={place: (float(np.nanmin(t)), float(np.nanmax(t)))
                               for place, t in used.temperatures.items() if np.isfinite(t).any()},
            alone=estimate.alone,
        )  # fmt: skip

    def save(self, path: Path | str) -> None:
        """Write the file whole or not at all. Raises CalibrationError when the folder is missing, or where
        `load_calibration` would refuse it."""
        path = Path(path)
        if not path.parent.is_dir():
            raise CalibrationError(f"{path}: the folder {path.parent} does not exist")
        if wrong := _unfit(self):
            raise CalibrationError(f"{path}: not written, as no command would read it: {wrong}")
        content = self._as_dict()
        content["content_sha256"] = content_digest(content)
        write_text(path, json.dumps(content, indent=1), CalibrationError)

    def _as_dict(self) -> dict[str, Any]:
        machine, std = self.machine, self.std
        terms: list[dict[str, Any]] = []
        at = 0
        everything: list[FrameTerm | TargetOffset] = [*self.model.terms]
        if self.model.target_offset is not None:
            everything.append(self.model.target_offset)
        for term in everything:
            parameters = term.parameters(machine.frame_names)
            values = [
                {"name": p.name, "value": float(self.theta[at + k]), "std": float(std[at + k]), "unit": p.unit}
                for k, p in enumerate(parameters)
            ]
            at += len(parameters)
            terms.append({**term.as_dict(), "parameters": values})
        return {
            "format": FORMAT,
            "provenance": self.provenance,
            "valid": {
                "joints": dict(zip(machine.joint_names, self.joint_range.tolist(), strict=True)),
                "payload": dict(zip(WRENCH_COMPONENTS, self.payload_range.tolist(), strict=True)),
                "temperatures": {place: list(ends) for place, ends in self.temperature_range.items()},
            },
            "sampled": self.sampled,
            "measuring_in_base": self.measuring_in_base.tolist(),
            "bent_by": machine.bent_by,
            "targets": {name: xyz.tolist() for name, xyz in machine.targets.items()},
            "noise": {
                "pose": self.noise.pose.tolist(),
                "instrument": self.noise.instrument,
                "joints": None if self.noise.parts is None else self.noise.parts[1:].tolist(),
                "end_effector": None if self.noise.parts is None else self.noise.parts[0].tolist(),
            },
            "terms": terms,
            "effects": [effect.as_dict() for effect in self.effects],
            "reference": self.reference,
            "laid": None if self.laid is None else self.laid.tolist(),
            "strengths": self.strengths,
            "ambiguous": list(self.ambiguous),
            "visits": None if self.visits is None else earlier.as_dict(self.visits),
            "covariance": _pack(self.covariance),
        }


def load_calibration(path: Path | str, machine: Machine) -> Calibration:
    """Read a calibration for this machine.

    Raises CalibrationError when the file is missing, cut off, of another format or made for another machine file.
    """
    path = Path(path)
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise CalibrationError(f"{path}: no such calibration") from None
    except IsADirectoryError:
        raise CalibrationError(f"{path}: a folder, expected a calibration") from None
    except (UnicodeDecodeError, OSError) as exc:
        raise CalibrationError(f"{path}: cannot be read as UTF-8 text ({exc})") from None
    except (ValueError, RecursionError) as exc:
        cut = "the file is empty" if path.stat().st_size == 0 else f"not valid JSON, or cut off ({exc})"
        raise CalibrationError(f"{path}: {cut}") from None
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        found = data.get("format") if isinstance(data, dict) else type(data).__name__
        raise CalibrationError(f"{path}: expected format '{FORMAT}', found {found!r}")
    try:
        made_for, made_from = data["provenance"]["machine_name"], data["provenance"]["machine_sha256"]
        if made_from != machine.sha256:
            changed = "; the file has changed since, identify again" if made_for == machine.name else ""
            raise CalibrationError(
                f"{path}: made for machine '{made_for}' (file {made_from[:12]}), "
                f"not for '{machine.name}' ({machine.file}, {machine.sha256[:12]}){changed}"
            )
        if data.get("content_sha256") != content_digest(data):
            raise ValueError("the content does not match its content_sha256; was it edited by hand?")
        calibration = _from_dict(data, machine)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError, zlib.error) as exc:
        what = f"'{exc.args[0]}' is missing" if isinstance(exc, KeyError) else str(exc)
        raise CalibrationError(f"{path}: damaged: {what}") from None
    if wrong := _unfit(calibration):
        raise CalibrationError(f"{path}: damaged: {wrong}")
    return calibration


def _unfit(found: Calibration) -> str:
    """What about a calibration's numbers no command could go by; empty where there is nothing."""
    everything = {"terms": found.theta, "covariance": found.covariance, "measuring_in_base": found.measuring_in_base,
                  "valid.joints": found.joint_range, "valid.payload": found.payload_range, "noise": found.noise.pose,
                  "valid.temperatures": np.array(list(found.temperature_range.values())),
                  "strengths": np.array(list(found.strengths.values())),
                  "noise.instrument": np.array(found.noise.instrument),
                  "targets": found.machine.target_array}  # fmt: skip
    if found.alone is not None:
        everything["terms' std"] = found.alone
    if found.laid is not None:
        everything["laid"] = found.laid
    if found.noise.instrument <= 0:
        return "noise.instrument is no standard deviation"
    if found.noise.parts is not None:
        if (found.noise.parts < 0).any():
            return "noise.joints or noise.end_effector holds negative variances"
        everything["noise.joints"] = found.noise.parts
    for effect in found.effects:
        numbers = np.concatenate([effect.values, effect.std, np.ravel(effect.correlation)])
        everything[f"effects.{effect.name}"] = numbers
        if effect.mimicked.size and effect.mimicked.shape[1] != len(found.theta):
            return (f"'mimicked' of {effect.name} is for {effect.mimicked.shape[1]} parameters, expected "
                    f"{len(found.theta)}")  # fmt: skip
        everything[f"effects.{effect.name}.mimicked"] = effect.mimicked
    for name, values in everything.items():
        if not (np.abs(values) <= LARGEST).all():
            return f"{name} holds values that are not finite numbers below {LARGEST:g}"
    turn = found.measuring_in_base[:3, :3]
    if np.abs(turn @ turn.T - np.eye(3)).max() > 1e-9 or found.measuring_in_base[3].tolist() != [0, 0, 0, 1]:
        return "measuring_in_base is no rotation and displacement"
    return ""


def _from_dict(data: dict[str, Any], machine: Machine) -> Calibration:
    targets = {name: np.array(data["targets"][name], dtype=float).reshape(3) for name in machine.targets}
    moved = machine.with_targets(targets)
    if (bent_by := data.get("bent_by", "own" if data.get("hangs", True) else "beyond")) not in get_args(BentBy):
        raise ValueError(f"'bent_by' is {bent_by!r}, expected one of {', '.join(get_args(BentBy))}")
    moved = replace(moved, bent_by=bent_by)
    terms: list[FrameTerm] = []
    target_offset = None
    values: list[float] = []
    stated: list[float] = []
    for item in data["terms"]:
        values += [float(p["value"]) for p in item["parameters"]]
        stated += [float(p["std"]) for p in item["parameters"]]
        if item["kind"] == "geometric":
            terms.append(Geometric.from_dict(item))
        elif item["kind"] == "compliance":
            terms.append(Compliance.from_dict(item))
        elif item["kind"] == "own_motion":
            terms.append(OwnMotion.from_dict(item))
        elif item["kind"] == "target_offset":
            target_offset = TargetOffset.from_dict(item)
        else:
            raise ValueError(f"unknown term '{item['kind']}'")
    model = Model(moved, tuple(terms), target_offset)
    covariance = _unpack(data["covariance"])
    if not len(values) == len(model.parameters()) == len(covariance):
        raise ValueError(f"{len(values)} values for {len(model.parameters())} parameters")
    laid = None if data.get("laid") is None else np.array(data["laid"], dtype=float)
    if laid is not None and laid.shape != (len(values),):
        raise ValueError(f"{laid.size} values in 'laid' for {len(values)} parameters")
    return Calibration(
        model,
        np.array(values),
        covariance,
        _noise(data["noise"], machine),
        np.array(data["measuring_in_base"], dtype=float).reshape(4, 4),
        np.array([data["valid"]["joints"][j] for j in machine.joint_names], dtype=float).reshape(-1, 2),
        np.array([data["valid"]["payload"][c] for c in WRENCH_COMPONENTS], dtype=float).reshape(6, 2),
        data["sampled"],
        data["provenance"],
        tuple(Effect.from_dict(item) for item in data.get("effects", [])),
        {str(k): float(v) for k, v in data.get("reference", {}).items()},
        {str(k): float(v) for k, v in data.get("strengths", {}).items()},
        tuple(data.get("ambiguous", [])),
        _visits(data, machine),
        {str(p): (float(low), float(high)) for p, (low, high) in data["valid"].get("temperatures", {}).items()},
        laid,
        np.maximum(np.array(stated) ** 2 - np.diag(covariance), 0.0),
    )


def _visits(data: dict[str, Any], machine: Machine) -> Recording | None:
    if data.get("visits") is None:
        return None
    made_from = data["provenance"]
    return earlier.from_dict(data["visits"], machine, made_from["recording"], made_from["recording_sha256"])


def _noise(data: dict[str, Any], machine: Machine) -> Noise:
    parts = None
    if (joints := data.get("joints")) is not None:
        beside = data.get("end_effector")  # of older files joints alone
        parts = np.zeros((1 + machine.n, 6))
        parts[0] = 0.0 if beside is None else np.array(beside, dtype=float).reshape(6)
        parts[1:] = np.array(joints, dtype=float).reshape(machine.n, 6)
    return Noise(np.array(data["pose"], dtype=float).reshape(6, 6), float(data["instrument"]), parts)


def content_digest(content: dict[str, Any]) -> str:
    """Of what the file says, however it is laid out: axes move by these numbers, so no digit may change unseen."""
    rest = {key: value for key, value in content.items() if key != "content_sha256"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def _pack(covariance: Array) -> dict[str, Any]:
    lower = packed(covariance[np.tril_indices(len(covariance))])
    return {"size": len(covariance), "encoding": f"lower triangle by rows, {lower['encoding']}", "data": lower["data"]}


def _unpack(data: dict[str, Any]) -> Array:
    size = int(data["size"])
    out = np.zeros((size, size))
    out[np.tril_indices(size)] = unpacked({"shape": [size * (size + 1) // 2], "data": data["data"]})
    return out + np.tril(out, -1).T
