"""What depends on how and where the joints moved: lost motion, friction, periods, jumping zeros, joints that meddle."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

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
    twist, component = scene.own_freedom(k)
    softness = rng.uniform(2.0, 8.0)

    def lag(s: Scene, gap: float) -> Array:
        path = s.campaign.commanded[:, k]
        steps = _way(s.campaign.before[0, k], path)
        wear = np.exp(-((s.unit_position(k) / 0.5) ** 2))
        half = gap / 2 * (1.0 if form != "worn in the middle" else 0.6 + 0.8 * wear)
        half = np.broadcast_to(half, path.shape)
        behind, out = 0.0, np.zeros(len(path))
        for v, step in enumerate(steps):
            if form == "soft walls":  # approaches the wall exponentially with the way driven
                wall = float(np.sign(step)) * half[v]
                behind = wall + (behind - wall) * float(np.exp(-abs(step) / (softness * gap))) if step else behind
            else:
                behind = float(np.clip(behind + step, -half[v], half[v]))
            out[v] = behind
        return -out

    return Concealed(
        scene, "backlash", form, name, component, (f"approach_{name}",),
        lambda s, gap: Change(eps=s.eps(k, lag(s, gap)[:, None] * twist)), lambda gap: {"gap": gap}, start=2e-4,
    )  # fmt: skip


def friction_hysteresis(scene: Scene, rng: np.random.Generator) -> Concealed:
    """The drive winds up before it slips: behind by an amount that grows with the way since the last reversal.

    Maxwell slip  springs in parallel, each slipping at a way of its own    (Lampaert, Swevers & Al-Bender 2002)
    Bouc-Wen      dz = dq (1 − |z|ⁿ (½ + ½ sgn(dq z)))/w: gives way late (n > 1) or early (n < 1), and returns along a
                  straight line                                                      (Wen 1976, with β = γ)
    """
    k, name = _pick(scene, rng)
    form = str(rng.choice(["Maxwell slip", "Bouc-Wen"]))
    twist, component = scene.own_freedom(k)
    count = int(rng.integers(3, 6)) if form == "Maxwell slip" else 0
    breakaway, share = np.zeros(0), np.zeros(0)
    if form == "Maxwell slip":
        breakaway = scene.travel(k) * np.exp(rng.uniform(np.log(0.02), np.log(0.4), count))
        share = rng.dirichlet(np.full(count, 2.0))
        way = float(share @ breakaway)
    else:
        way = scene.travel(k) * float(np.exp(rng.uniform(np.log(0.05), np.log(0.25))))
    exponent = float(rng.choice([0.6, 1.7, 2.5]))

    def state(s: Scene) -> Array:
        steps = _way(s.campaign.before[0, k], s.campaign.commanded[:, k])
        out, z, one = np.zeros(len(steps)), np.zeros(count), 0.0
        for v, step in enumerate(steps):
            if count:
                z = np.clip(z + step, -breakaway, breakaway)
                out[v] = share @ (z / breakaway)
            else:
                way_left = float(np.clip(step / way, -15.0, 15.0))  # 15 ways on, nothing changes any more
                parts = int(np.ceil(abs(way_left) / 0.05))
                for _ in range(parts):  # by midpoints
                    half = one + 0.5 * way_left / parts * _yielding(one, way_left, exponent)
                    one = float(np.clip(one + way_left / parts * _yielding(half, way_left, exponent), -1.0, 1.0))
                out[v] = one
        return out

    return Concealed(
        scene, "friction_hysteresis", form, name, component, (f"approach_{name}", f"q_{name}"),
        lambda s, size: Change(eps=s.eps(k, -size * state(s)[:, None] * twist)),
        lambda size: {"wind_up": size, "way": way},
    )  # fmt: skip


def _yielding(state: float, step: float, exponent: float) -> float:
    return 1.0 - (abs(state) ** exponent if state * step > 0 else 0.0)


def periodic_transmission(scene: Scene, rng: np.random.Generator) -> Concealed:
    """A screw's pitch, a gear's mesh, an eccentric encoder: the same error turn after turn.

    two harmonics  the turn itself and its double, each with a phase of its own
    tooth          rises slowly and falls back fast, like worn flanks
    """
    k, name = _pick(scene, rng)
    form = str(rng.choice(["two harmonics", "tooth"]))
    # between a tenth of the travel, which a smooth error function cannot follow, and a sixtieth
    period = scene.travel(k) * float(np.exp(rng.uniform(np.log(1 / 60), np.log(1 / 10))))
    phase = rng.uniform(0, 1, 2)
    second = rng.uniform(0.1, 0.5) if form == "two harmonics" else 0.0
    steep = rng.uniform(0.75, 0.9) if form == "tooth" else 1.0

    def wave(s: Scene) -> Array:
        turn = s.q[:, k] / period
        if form == "two harmonics":
            return np.asarray(np.sin(2 * np.pi * (turn + phase[0])) + second * np.sin(4 * np.pi * (turn + phase[1])))
        place = np.mod(turn + phase[0], 1.0)
        return np.asarray(np.where(place < steep, 2 * place / steep - 1, 1 - 2 * (place - steep) / (1 - steep)))

    twist, component = scene.own_freedom(k)
    return Concealed(
        scene, "periodic_transmission", form, name, component, (f"q_{name}",),
        lambda s, size: Change(eps=s.eps(k, size * wave(s)[:, None] * twist)),
        lambda size: {"amplitude": size, "period": period},
    )  # fmt: skip


def zero_shift(scene: Scene, rng: np.random.Generator) -> Concealed:
    """The joint's zero is another one from some moment on: a coupling slipped, the drive was homed anew.

    jump     once and for all;   creeping back: 40 % of the jump are lost again within hours
    two      it slips twice, the second time by 0.4 to 0.8 as much again
    """
    k, name = _pick(scene, rng)
    form = str(rng.choice(["jump", "creeping back", "two jumps"]))
    time = scene.campaign.time
    when = float(time[0] + (time[-1] - time[0]) * rng.uniform(0.2, 0.6))
    fading = rng.uniform(1800, 7200) if form == "creeping back" else np.inf
    second, later = 0.0, when
    if form == "two jumps":
        second, later = rng.uniform(0.4, 0.8), when + rng.uniform(0.15, 0.3) * (time[-1] - time[0])

    def step(s: Scene) -> Array:
        now = s.campaign.time
        left = 0.6 + 0.4 * np.exp(-np.maximum(now - when, 0.0) / fading) if form == "creeping back" else 1.0
        return np.asarray(np.where(now >= when, 1.0, 0.0) * left + second * (now >= later))

    twist, component = scene.own_freedom(k)
    sign = rng.choice([-1.0, 1.0])
    return Concealed(
        scene, "zero_shift", form, name, component, ("time",),
        lambda s, size: Change(eps=s.eps(k, sign * size * step(s)[:, None] * twist)),
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
    a, b, phase = rng.uniform(1.5, 4.0), rng.uniform(1.5, 4.0), rng.uniform(0, 2 * np.pi, 2)
    shapes: dict[str, Callable[[Array, Array], Array]] = {
        "bilinear": lambda u, w: u * w,
        "waves": lambda u, w: np.sin(a * u + phase[0]) * np.sin(b * w + phase[1]),
        "corner": lambda u, w: np.maximum(u + 0.3, 0.0) * np.maximum(w + 0.3, 0.0),
    }

    def shape(s: Scene) -> Array:
        return shapes[form](s.unit_position(k), s.unit_position(other))

    component = int(rng.integers(6))
    twist = np.eye(6)[component]
    return Concealed(
        scene, "cross_coupling", form, name, COMPONENTS[component], (f"q_{name}", f"q_{second}"),
        lambda s, size: Change(eps=s.eps(k, size * shape(s)[:, None] * twist)),
        lambda size: {"size": size}, also=(second,),
    )  # fmt: skip
