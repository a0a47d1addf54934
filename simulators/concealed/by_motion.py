"""What depends on how and where the joints moved: lost motion, friction, periods, jumping zeros, joints that meddle."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from simulators.chain import Array
from simulators.concealed.scene import COMPONENTS, Change, Concealed, Scene


def _pick(scene: Scene, rng: np.random.Generator) -> tuple[int, str]:
    k = int(rng.integers(len(scene.chain.joints)))
    return k, scene.chain.joints[k].name


def _way(start: float, path: Array) -> Array:
    """Increments of one joint's motion from where it started."""
    return np.diff(path, prepend=start)


def backlash(scene: Scene, rng: np.random.Generator) -> Concealed:
    """The joint stays behind its encoder by up to half the gap, on the side from which it was pushed last.

    play    a block in a slot: the output moves only when a wall pushes it
    soft    walls of rubber: the last bit of the gap is taken up over a way of some gaps  (Nordin & Gutman 2002)
    worn    a play whose gap is widest in the middle of the travel, where the machine works most
    """
    k, name = _pick(scene, rng)
    form = str(rng.choice(["play", "soft walls", "worn in the middle"]))
    path = scene.campaign.commanded[:, k]
    steps = _way(scene.campaign.before[0, k], path)
    twist, component = scene.own_freedom(k)
    softness = rng.uniform(2.0, 8.0)
    wear = np.exp(-((scene.unit_position(k) / 0.5) ** 2))

    def lag(gap: float) -> Array:
        half = gap / 2 * (1.0 if form != "worn in the middle" else 0.6 + 0.8 * wear)
        half = np.broadcast_to(half, path.shape)
        behind, out = 0.0, np.zeros(len(path))
        for v, step in enumerate(steps):
            if form == "soft walls":  # approaches the wall exponentially with the way driven
                wall = float(np.sign(step)) * half[v]
                behind = (
                    wall + (behind - wall) * float(np.exp(-abs(step) / (softness * gap))) if step else behind
                )
            else:
                behind = float(np.clip(behind + step, -half[v], half[v]))
            out[v] = behind
        return -out

    return Concealed(
        "backlash", form, name, component, (f"approach_{name}",),
        lambda gap: Change(eps=scene.eps(k, lag(gap)[:, None] * twist)), lambda gap: {"gap": gap}, start=2e-4,
    )  # fmt: skip


def friction_hysteresis(scene: Scene, rng: np.random.Generator) -> Concealed:
    """The drive winds up before it slips: behind by an amount that grows with the way since the last reversal.

    Maxwell slip  springs in parallel, each slipping at a way of its own    (Lampaert, Swevers & Al-Bender 2002)
    Dahl          dz = dq (1 − sgn(dq) z)/w: approaches full friction exponentially      (Dahl 1968)
    """
    k, name = _pick(scene, rng)
    form = str(rng.choice(["Maxwell slip", "Dahl"]))
    steps = _way(scene.campaign.before[0, k], scene.campaign.commanded[:, k])
    twist, component = scene.own_freedom(k)
    state = np.zeros(len(steps))
    if form == "Maxwell slip":
        count = int(rng.integers(3, 6))
        breakaway = scene.travel(k) * np.exp(rng.uniform(np.log(0.02), np.log(0.4), count))
        share = rng.dirichlet(np.full(count, 2.0))
        z = np.zeros(count)
        for v, step in enumerate(steps):
            z = np.clip(z + step, -breakaway, breakaway)
            state[v] = share @ (z / breakaway)
        way = float(share @ breakaway)
    else:
        way = scene.travel(k) * float(np.exp(rng.uniform(np.log(0.05), np.log(0.25))))
        one = 0.0
        for v, step in enumerate(steps):
            wall = float(np.sign(step))
            one = wall + (one - wall) * float(np.exp(-abs(step) / way)) if step else one
            state[v] = one
    return Concealed(
        "friction_hysteresis", form, name, component, (f"approach_{name}", f"q_{name}"),
        lambda size: Change(eps=scene.eps(k, -size * state[:, None] * twist)),
        lambda size: {"wind_up": size, "way": way},
    )  # fmt: skip


def periodic_transmission(scene: Scene, rng: np.random.Generator) -> Concealed:
    """A screw's pitch, a gear's mesh, an eccentric encoder: the same error turn after turn.

    two harmonics  the turn itself and its double, each with a phase of its own
    tooth          rises slowly and falls back fast, like worn flanks
    """
    k, name = _pick(scene, rng)
    form = str(rng.choice(["two harmonics", "tooth"]))
    # between an eighth of the travel, which a smooth error function cannot follow, and a sixtieth
    period = scene.travel(k) * float(np.exp(rng.uniform(np.log(1 / 60), np.log(1 / 10))))
    turn = scene.q[:, k] / period
    phase = rng.uniform(0, 1, 2)
    if form == "two harmonics":
        second = rng.uniform(0.1, 0.5)
        wave = np.sin(2 * np.pi * (turn + phase[0])) + second * np.sin(4 * np.pi * (turn + phase[1]))
    else:
        steep = rng.uniform(0.75, 0.9)
        place = np.mod(turn + phase[0], 1.0)
        wave = np.where(place < steep, 2 * place / steep - 1, 1 - 2 * (place - steep) / (1 - steep))
    twist, component = scene.own_freedom(k)
    return Concealed(
        "periodic_transmission", form, name, component, (f"q_{name}",),
        lambda size: Change(eps=scene.eps(k, size * wave[:, None] * twist)),
        lambda size: {"amplitude": size, "period": period},
    )  # fmt: skip


def zero_shift(scene: Scene, rng: np.random.Generator) -> Concealed:
    """The joint's zero is another one from some moment on: a coupling slipped, the drive was homed anew.

    jump     once and for all;   creeping back: half of the jump is lost again within hours
    two      it slips twice, the second time further
    """
    k, name = _pick(scene, rng)
    form = str(rng.choice(["jump", "creeping back", "two jumps"]))
    time = scene.campaign.time
    when = float(time[0] + (time[-1] - time[0]) * rng.uniform(0.2, 0.6))
    step = np.where(time >= when, 1.0, 0.0)
    if form == "creeping back":
        step = step * (0.6 + 0.4 * np.exp(-np.maximum(time - when, 0.0) / rng.uniform(1800, 7200)))
    if form == "two jumps":
        step = step + rng.uniform(0.4, 0.8) * (time >= when + rng.uniform(0.15, 0.3) * (time[-1] - time[0]))
    twist, component = scene.own_freedom(k)
    sign = rng.choice([-1.0, 1.0])
    return Concealed(
        "zero_shift", form, name, component, ("time",),
        lambda size: Change(eps=scene.eps(k, sign * size * step[:, None] * twist)),
        lambda size: {"jump": sign * size, "after_s": when},
    )  # fmt: skip


def cross_coupling(scene: Scene, rng: np.random.Generator) -> Concealed:
    """A joint's guide is bent by where another joint stands.

    bilinear   the product of both positions;   waves: a product of sines
    corner     only where both are in the same corner of their travels
    """
    # the first joint's guide cannot feel what stands behind it only by geometry; any pair may
    k, other = (int(x) for x in rng.choice(len(scene.chain.joints), 2, replace=False))
    name, second = scene.chain.joints[k].name, scene.chain.joints[other].name
    form = str(rng.choice(["bilinear", "waves", "corner"]))
    u, w = scene.unit_position(k), scene.unit_position(other)
    a, b, phase = rng.uniform(1.5, 4.0), rng.uniform(1.5, 4.0), rng.uniform(0, 2 * np.pi, 2)
    shapes: dict[str, Callable[[], Array]] = {
        "bilinear": lambda: u * w,
        "waves": lambda: np.sin(a * u + phase[0]) * np.sin(b * w + phase[1]),
        "corner": lambda: np.maximum(u + 0.3, 0.0) * np.maximum(w + 0.3, 0.0),
    }
    shape = shapes[form]()
    component = int(rng.integers(6))
    twist = _one(component)
    return Concealed(
        "cross_coupling", form, name, COMPONENTS[component], (f"q_{name}", f"q_{second}"),
        lambda size: Change(eps=scene.eps(k, size * shape[:, None] * twist)),
        lambda size: {"size": size}, also=(second,),
    )  # fmt: skip


def _one(component: int) -> NDArray[np.float64]:
    twist = np.zeros(6)
    twist[component] = 1.0
    return twist
