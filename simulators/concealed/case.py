"""Draw a case, dimension its effect, write what a site would hand over, and seal the rest."""

from __future__ import annotations

import csv
import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from simulators.chain import Array, read_chain
from simulators.concealed.campaign import Campaign, draw_campaign
from simulators.concealed.catalogue import KNOWN, UNKNOWN, chosen
from simulators.concealed.geometry import draw_machine, without_compliance
from simulators.concealed.scene import Change, Concealed, Scene, rms
from simulators.plant import Plant
from simulators.recorded import ENCODER_SIGMA, FORCE_SIGMA, header

THERMOMETER_SIGMA = 0.02  # [K]
SEAL = "seal.sha256"
TRUTH = "truth.json"
CALIBRATED_TO = 0.003  # the asked size is met to this relative error


@dataclass(frozen=True)
class Sized:
    """An effect with its size: what it changes, and the field (N, T, 3) by which it moves the reflectors [m]."""

    concealed: Concealed
    amplitude: float
    change: Change
    field: Array


def make_case(
    seed: int,
    machine: str,
    effect: str,
    size: float,
    out: Path,
    sealed: Path,
    visits: int = 600,
    fit: int = 450,
    salt: str = "",
    remembers: float = 0.0,
) -> str:
    """Write a case into `out` and its truth into `sealed`; returns the seal, a SHA-256 of the truth's bytes.

    size    rms of the effect at the reflectors over the whole campaign, in units of the repeatability's there, before
            any model has absorbed any of it. Of a pair each has it.
    fit     the first so many visits are the recording; the rest, later in time, is held out
    salt    goes into the truth, so that nobody can hash his way through all effects and compare
    remembers  correlation of every joint's scatter with that of the visit before
    """
    if not -1.0 < remembers < 1.0:
        raise ValueError(f"a correlation of {remembers:g}, expected one between -1 and 1")
    if out.resolve() == sealed.resolve():
        raise ValueError(f"{out}: the truth must not lie beside the case")
    if not 0 < fit <= visits:
        raise ValueError(f"{fit} visits to fit of {visits}")
    out.mkdir(parents=True, exist_ok=True)
    sealed.mkdir(parents=True, exist_ok=True)
    geometry_rng, campaign_rng, noise_rng, choice_rng = np.random.default_rng([seed, 77]).spawn(4)
    names = chosen(effect, choice_rng)
    entry = draw_machine(machine, geometry_rng)
    rigid: tuple[str, ...] = ()
    # the first joint's spring cannot be told from the floor's, which is the other form
    if "missing_compliance" in names and choice_rng.random() < 0.7:
        rigid = (str(choice_rng.choice([joint["name"] for joint in entry["joints"][1:]])),)
        entry = without_compliance(entry, rigid[0])
    file = out / "machine.yaml"
    file.write_text(yaml.safe_dump(entry, sort_keys=False), encoding="utf-8")
    plant = Plant(read_chain(file), seed=int(geometry_rng.integers(2**31)))
    campaign = draw_campaign(plant.chain, visits, campaign_rng)
    q = campaign.commanded + ENCODER_SIGMA * noise_rng.normal(size=campaign.commanded.shape)
    scene = Scene.of(plant, campaign, q, noise_rng, rigid).remembering(remembers)
    floor = rms(scene.points() - scene.points(random=False))
    sized = [_draw_effect(scene, name, seed, size * floor) for name in names]
    _write_recordings(scene, [s.change for s in sized], out, fit, noise_rng)
    asked = {"salt": salt, "seed": seed, "machine": machine, "asked": effect, "size": size, "fit": fit,
             "remembers": remembers}  # fmt: skip
    document = _truth(scene, sized, floor, asked)
    return _seal(document, out, sealed)


def _draw_effect(scene: Scene, name: str, seed: int, wanted: float) -> Sized:
    """Of its own stream, so that another effect on the same machine and campaign is not drawn for the same joint."""
    return dimension(scene, {**KNOWN, **UNKNOWN}[name](scene, np.random.default_rng([seed, *name.encode()])), wanted)


def dimension(scene: Scene, concealed: Concealed, wanted: float) -> Sized:
    """Find the amplitude at which the effect moves the reflectors by `wanted` [m] rms. Nearly linear, so that a few
    corrections in proportion do; an effect that cannot reach the size is an error of the generator."""
    if wanted == 0.0:
        nothing = concealed.change(0.0)
        return Sized(concealed, 0.0, nothing, scene.field(nothing))
    amplitude = concealed.start
    for _ in range(12):
        change = concealed.change(amplitude)
        field = scene.field(change)
        found = rms(field)
        if abs(found - wanted) < CALIBRATED_TO * wanted:
            return Sized(concealed, amplitude, change, field)
        if found == 0.0:
            break
        amplitude *= wanted / found
    where = f"{found:.2e} m at amplitude {amplitude:.2e}"
    raise ValueError(f"{concealed.effect}, {concealed.form}: {where}, not {wanted:.2e} m")


def _write_recordings(scene: Scene, changes: Sequence[Change], out: Path, fit: int, rng: np.random.Generator) -> None:
    c, plant = scene.campaign, scene.plant
    points = scene.points(changes) + plant.position_sigma * rng.normal(size=(len(c), len(scene.targets), 3))
    wrench = scene.sensed(changes) + FORCE_SIGMA * rng.normal(size=(len(c), 6))
    warm = {k: t + THERMOMETER_SIGMA * rng.normal(size=len(t)) for k, t in c.temperature.items()}
    began = datetime(2026, 3, 2, 5, 0, tzinfo=UTC) + timedelta(seconds=int(rng.integers(0, 14 * 86400)))
    for name, rows in (("recording.csv", range(fit)), ("held_out.csv", range(fit, len(c)))):
        if not rows:
            continue
        with (out / name).open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(header(plant.joint_names, plant.targets, warm, c.other))
            writer.writerows(_row(scene, c, v, points[v], wrench[v], warm, began) for v in rows)


def _row(
    scene: Scene, c: Campaign, v: int, points: Array, wrench: Array, warm: dict[str, Array], began: datetime
) -> list[str]:
    when = (began + timedelta(seconds=float(c.time[v]))).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    return [
        when, c.step[v], c.load[v],
        *(f"{x:.8f}" for x in c.commanded[v]), *(f"{x:.8f}" for x in scene.q[v]), *(str(x) for x in c.approach[v]),
        f"{c.settle[v]:.2f}", *(f"{x:.4f}" for x in wrench), *(f"{x:.7f}" for x in points.ravel()),
        *(f"{t[v]:.3f}" for t in warm.values()), *(f"{x[v]:.2f}" for x in c.other.values()),
    ]  # fmt: skip


def _truth(scene: Scene, sized: Sequence[Sized], floor: float, asked: dict[str, Any]) -> dict[str, Any]:
    """Everything that scoring needs, so that it need not ask the generator again."""
    effects = [
        {
            "effect": s.concealed.effect,
            "form": s.concealed.form,
            "known": s.concealed.effect in KNOWN,
            "joint": s.concealed.joint,
            "also": list(s.concealed.also),
            "target": s.concealed.target,
            "component": s.concealed.component,
            "covariates": list(s.concealed.covariates),
            "neighbours": list(s.concealed.neighbours),
            "parameters": s.concealed.parameters(s.amplitude),
            "rms_mm": 1e3 * rms(s.field),
            "field_nm": np.rint(1e9 * s.field).astype(int).tolist(),
        }
        for s in sized
    ]
    return {
        **asked,
        "visits": len(scene),
        "repeatability_rms_mm": 1e3 * floor,
        "scatter": scene.plant.truth.scatter.tolist(),
        "instrument_sigma": scene.plant.position_sigma,
        "effects": effects,
    }


def _seal(document: dict[str, Any], out: Path, sealed: Path) -> str:
    """The truth's bytes, written whole or not at all, and their hash beside the case."""
    text = json.dumps(document).encode()
    partial = sealed / (TRUTH + ".part")
    partial.write_bytes(text)
    os.replace(partial, sealed / TRUTH)
    digest = hashlib.sha256(text).hexdigest()
    (out / SEAL).write_text(digest + "\n", encoding="utf-8")
    return digest
