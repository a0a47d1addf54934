"""A concealed effect on the machine that moves: what the live plant carries beyond its own truth, sealed.

What the effect depends on, where it sits and how large it is are drawn and dimensioned on a rehearsal: a campaign as
long as the one to come, drawn from the seed (campaign.py). On the real one the effect's own formula then looks back
over all that the machine has gone through so far: poses it stood at or turned at, loads, times, temperatures.

Known limitations: noise (`outliers`, `unsettled`) is no effect to carry, as it is drawn visit by visit; the floor is
the only spring that `missing_compliance` can add, as the machine file is given; the path between two poses is straight.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from simulators import chain as kinematics
from simulators.chain import Array, displacement
from simulators.concealed.campaign import Campaign, draw_campaign
from simulators.concealed.case import dimension
from simulators.concealed.catalogue import KNOWN
from simulators.concealed.scene import Change, Concealed, Scene, rms
from simulators.plant import STANDSTILL, Load, Plant, temperatures

CARRIED = tuple(name for name in KNOWN if name not in ("outliers", "unsettled"))
REHEARSED = 400  # visits of the rehearsal
ANEW_S = 1.0  # what depends on time is looked at anew after so long
Ways = Callable[[], list[tuple[float, Array]]]


@dataclass(frozen=True)
class _Row:
    """One pose that the machine stood at or turned at, and what acts there."""

    time: float
    q: Array
    load: Load | None
    poses: Array
    wrench: Array
    carried: Array
    payload: Array


class CarriedEffect:
    """One effect with its size, as the live plant carries it. Not for two threads at once.

    ways  gives the poses that the axes were sent to since it was last asked, each with the time when they left for it
    """

    def __init__(self, plant: Plant, concealed: Concealed, amplitude: float, truth: bytes, ways: Ways) -> None:
        self._plant, self._concealed, self._amplitude, self._ways = plant, concealed, amplitude, ways
        self.truth = truth
        self._rows: list[_Row] = []
        self._errs = concealed.change(amplitude).wrench is not None  # an error of the force sensor, of nothing else
        self._at_home = np.clip(0.0, plant.lower, plant.upper)

    @property
    def seal(self) -> str:
        """SHA-256 of the truth, salt and all: may be shown before anybody has looked."""
        return hashlib.sha256(self.truth).hexdigest()

    def seen(
        self, now: float, q: Array, load: Load | None, deviation: Array, names: tuple[str, ...]
    ) -> dict[str, Array]:
        """Where the reflectors are seen: {name: (3,)} in the measuring frame [m]. This pose joins the past."""
        self._arrive(now, q, load)
        change = self._change(self._rows)
        plant = self._plant
        tip = plant.true_tip(q, load, deviation if change.eps is None else deviation + change.eps)
        if change.base is not None:
            tip = displacement(change.base) @ tip
        known = {**plant.points, **plant.targets}
        to_measuring = np.linalg.inv(plant.measuring_in_base)
        out = {}
        for name in names:
            at = np.array(known[name])
            where = list(plant.targets).index(name) if name in plant.targets else None
            if change.on_tip is not None and where is not None:
                at = at + change.on_tip[0, where]
            point = tip[0, :3, :3] @ at + tip[0, :3, 3]
            if change.stretch is not None:
                station = np.zeros(3) if change.station is None else change.station
                point = point + change.stretch[0] * (point - station)
            out[name] = to_measuring[:3, :3] @ point + to_measuring[:3, 3]
        return out

    def sensed(self, now: float, q: Array, load: Load | None) -> Array:
        """(6,) what the force sensor says, without its noise [N, N m]."""
        said: Array = self._plant.wrench(q, load)[0]
        if not self._errs:
            return said
        change = self._change([*self._rows, self._row(now, q, load)])
        return said if change.wrench is None else said + change.wrench[0]

    def loaded(self, now: float, q: Array, load: Load | None) -> None:
        """The load was changed where the machine stands."""
        self._arrive(now, q, load)

    # --- the past ------------------------------------------------------------------------------------------
    def _arrive(self, now: float, q: Array, load: Load | None) -> None:
        ways = self._ways()
        for leaving, (_, passed) in zip(ways[1:], ways[:-1], strict=True):  # the last one is where it is now
            self._rows.append(self._row(leaving[0], passed, self._rows[-1].load if self._rows else load))
        last = self._rows[-1] if self._rows else None
        if last is None or np.abs(q - last.q).max() > STANDSTILL or load is not last.load or now - last.time > ANEW_S:
            self._rows.append(self._row(now, q, load))

    def _row(self, now: float, q: Array, load: Load | None) -> _Row:
        chain, one = self._plant.chain, np.atleast_2d(q)
        poses = kinematics.link_poses(chain, one)
        wrench = self._plant.wrench(one, load)
        carried = kinematics.link_wrenches(chain, poses, wrench)
        own = kinematics.link_wrenches(chain, poses, np.zeros_like(wrench))
        return _Row(now, np.array(q), load, poses[0], wrench[0], carried[0], (carried - own)[0])

    def _change(self, rows: list[_Row]) -> Change:
        """What the effect does at the last of these rows."""
        change = self._concealed.on(self._scene(rows), self._amplitude)
        return replace(
            change,
            **{
                name: getattr(change, name)[-1:]
                for name in ("eps", "base", "stretch", "on_tip", "readings", "wrench")
                if getattr(change, name) is not None
            },
        )

    def _scene(self, rows: list[_Row]) -> Scene:
        q = np.array([row.q for row in rows])
        before = np.vstack([self._at_home, q[:-1]])
        time = np.array([row.time for row in rows])
        felt = [temperatures(t) for t in time.tolist()]
        campaign = Campaign(
            step=[""] * len(rows),
            load=[""] * len(rows),
            commanded=q,
            before=before,
            approach=np.sign(q - before).astype(np.int64),
            time=time,
            settle=np.zeros(len(rows)),
            mass=np.array([0.0 if row.load is None else row.load.mass_kg for row in rows]),
            com=np.array([np.zeros(3) if row.load is None else row.load.com for row in rows]),
            temperature={place: np.array([one[place] for one in felt]) for place in felt[0]},
        )
        poses, wrench, carried, payload = (
            np.array([getattr(row, name) for row in rows]) for name in ("poses", "wrench", "carried", "payload")
        )
        targets = np.array(list(self._plant.targets.values()))
        return Scene(self._plant, campaign, q, poses, wrench, carried, payload, np.zeros_like(carried), (), targets)


def conceal(
    plant: Plant, seed: int, hours: float, salt: str, ways: Ways, size: float = 2.0, effect: str | None = None
) -> CarriedEffect:
    """Draw an effect for this machine: which one, where, how.

    hours   how long the campaign will take in which it is to be found: jumps and drifts fall into it
    size    rms at the reflectors over the rehearsal, in units of the repeatability's there
    effect  None: the seed picks one of CARRIED
    """
    pick, campaign_rng, scatter_rng, draw_rng = np.random.default_rng([seed, 4711]).spawn(4)
    name = effect or str(pick.choice(CARRIED))
    if name not in CARRIED:
        raise ValueError(f"no effect {name!r} to carry; there are {', '.join(CARRIED)}")
    campaign = _at_pace(draw_campaign(plant.chain, REHEARSED, campaign_rng), 3600.0 * hours)
    scene = Scene.of(plant, campaign, campaign.commanded, scatter_rng)
    floor = rms(scene.points() - scene.points(random=False))
    sized = dimension(scene, KNOWN[name](scene, draw_rng), size * floor)
    truth = json.dumps(_truth(sized.concealed, sized.amplitude, {
        "salt": salt, "seed": seed, "size": size, "rms_mm": 1e3 * rms(sized.field), "repeatability_rms_mm": 1e3 * floor,
    }), indent=1)  # fmt: skip
    return CarriedEffect(plant, sized.concealed, sized.amplitude, truth.encode(), ways)


def _at_pace(campaign: Campaign, seconds: float) -> Campaign:
    """The rehearsal in the time that the real campaign will take, in the simulated hall."""
    time = campaign.time * (seconds / campaign.time[-1])
    felt = [temperatures(t) for t in time.tolist()]
    return replace(
        campaign, time=time, temperature={place: np.array([one[place] for one in felt]) for place in felt[0]}
    )


def _truth(concealed: Concealed, amplitude: float, drawn: dict[str, Any]) -> dict[str, Any]:
    return {
        **drawn,
        "effect": concealed.effect,
        "form": concealed.form,
        "joint": concealed.joint,
        "also": list(concealed.also),
        "target": concealed.target,
        "component": concealed.component,
        "covariates": list(concealed.covariates),
        "neighbours": list(concealed.neighbours),
        "parameters": (values := concealed.parameters(amplitude)),
        "units": {name: concealed.unit(name) for name in values},
    }
