"""Effects that no catalogue holds: found they may be, named they may not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from simulators.chain import Array
from simulators.concealed.scene import COMPONENTS, Change, Concealed, Scene


def counterbalance_memory(scene: Scene, rng: np.random.Generator) -> Concealed:
    """A gas-spring counterbalance stays where the pose before left it: the error follows the last pose's height."""
    k, part = _frame(scene, rng, 3)

    def last(s: Scene) -> Array:
        height = -s.poses[:, -1, :3, 3] @ s.chain.gravity
        return np.concatenate([height[:1], height[:-1]])

    middle, spread = last(scene).mean(), last(scene).std()
    return _concealed(scene, "counterbalance_memory", "potential energy of the pose before", k, part,
                      lambda s: (last(s) - middle) / spread, ("previous_pose",))  # fmt: skip


def warm_load(scene: Scene, rng: np.random.Generator) -> Concealed:
    """A polymer bearing: softer when warm, and the softening stays until it has cooled past where it began."""
    k, part = _frame(scene, rng, 3, moments=True)
    air = scene.campaign.temperature["air"]
    middle, spread, most = air.mean(), air.std(), np.abs(scene.payload[:, k, part]).max()

    def shape(s: Scene) -> Array:
        warm = (s.campaign.temperature["air"] - middle) / spread
        state, held = np.zeros(len(warm)), float(warm[0])
        for v, value in enumerate(warm):  # play in temperature: softening lags by half a deviation either way
            held = float(np.clip(held, value - 0.5, value + 0.5))
            state[v] = held
        return np.asarray(state * s.payload[:, k, part] / most)

    return _concealed(scene, "warm_load", "temperature with play, times the load", k, part,
                      shape, ("temp_air_C", "Fx", "Fy", "Fz", "Mx", "My", "Mz"),
                      ("thermal_growth", "nonlinear_stiffness"))  # fmt: skip


def air_conditioning(scene: Scene, rng: np.random.Generator) -> Concealed:
    """A fan that goes on and off by the clock leans on the cantilever, the more the farther a joint is out."""
    k, part = _frame(scene, rng, len(scene.chain.joints))
    period = rng.uniform(2400, 5400)
    phase = rng.uniform(0, 2 * np.pi)

    def shape(s: Scene) -> Array:
        on = np.sign(np.sin(2 * np.pi * s.campaign.time / period + phase))
        return np.asarray(on * (0.3 + s.unit_position(k)))

    return _concealed(scene, "air_conditioning", f"on and off every {period / 2:.0f} s, times the joint's position", k,
                      part, shape, ("time", f"q_{scene.chain.joints[k].name}"),
                      ("thermal_growth",))  # fmt: skip


def resonance(scene: Scene, rng: np.random.Generator) -> Concealed:
    """Moves of one length excite the gantry; it comes to rest off its place in the direction of travel."""
    k, part = _frame(scene, rng, 3)
    at, width = rng.uniform(0.15, 0.4), rng.uniform(0.08, 0.2)

    def shape(s: Scene) -> Array:
        moved = (s.campaign.commanded - s.campaign.before)[:, k] / s.travel(k)
        return np.asarray(np.sign(moved) / (1 + ((np.abs(moved) - at) / width) ** 2))

    name = scene.chain.joints[k].name
    return _concealed(scene, "resonance", "length of the joint's last move", k, part, shape,
                      (f"approach_{name}", f"q_{name}", "previous_pose"),
                      ("friction_hysteresis", "backlash"))  # fmt: skip


def swelling(scene: Scene, rng: np.random.Generator) -> Concealed:
    """A composite link takes up water and swells, in an hour or two."""
    k, part = _frame(scene, rng, len(scene.chain.joints))
    slow = rng.uniform(1500, 6000)

    def shape(s: Scene) -> Array:
        time, humid = s.campaign.time, s.campaign.other["humidity"]
        taken = np.zeros(len(time))  # explicit Euler, in steps of a quarter of `slow` at most
        for v in range(1, len(time)):
            taken[v] = taken[v - 1] + (humid[v - 1] - humid[0] - taken[v - 1]) * (time[v] - time[v - 1]) / slow
        return taken

    return _concealed(scene, "swelling", f"humidity, {slow / 60:.0f} min behind", k, part, shape, ("cov_humidity",),
                      ("thermal_growth",))  # fmt: skip


def seat(scene: Scene, rng: np.random.Generator) -> Concealed:
    """A bolted joint keeps a set from whatever was the load before this one."""
    k, part = _frame(scene, rng, 3)

    def shape(s: Scene) -> Array:
        mass, kept = s.campaign.mass, np.zeros(len(s.campaign))
        for v in range(1, len(mass)):
            kept[v] = kept[v - 1] if s.campaign.load[v] == s.campaign.load[v - 1] else mass[v - 1]
        return np.asarray(kept / mass.max())

    return _concealed(scene, "seat", "mass of the load before", k, part, shape, ("load",), ("creep",))


def twisted_rails(scene: Scene, rng: np.random.Generator) -> Concealed:
    """Two axes that move together rack the carriage between them, and it stays so: the product of their last moves."""
    k, part = _frame(scene, rng, 3)
    other = (k + 1 + int(rng.integers(2))) % 3

    def shape(s: Scene) -> Array:
        moved = s.campaign.commanded - s.campaign.before
        return np.asarray(np.prod([moved[:, j] / s.travel(j) for j in (k, other)], axis=0))

    names = [scene.chain.joints[j].name for j in (k, other)]
    return _concealed(scene, "twisted_rails", "product of the last moves of two joints", k, part, shape,
                      ("previous_pose", *(f"q_{name}" for name in names)), ("cross_coupling",))  # fmt: skip


def _frame(scene: Scene, rng: np.random.Generator, first: int, moments: bool = False) -> tuple[int, int]:
    """One of the first joints' frames and a component of it; `moments`: one that the payload loads."""
    k = int(rng.integers(first))
    if not moments:
        return k, int(rng.integers(6))
    return k, 3 + int(rng.choice(np.flatnonzero(scene.payload[:, k, 3:].std(axis=0) > 1.0)))


def _concealed(
    scene: Scene,
    effect: str,
    form: str,
    k: int,
    part: int,
    shape: Callable[[Scene], Array],
    covariates: tuple[str, ...],
    neighbours: tuple[str, ...] = (),
) -> Concealed:
    twist = np.eye(6)[part]
    return Concealed(
        scene, effect, form, scene.chain.joints[k].name, COMPONENTS[part], covariates,
        lambda s, size: Change(eps=s.eps(k, size * shape(s)[:, None] * twist)), lambda size: {"size": size},
        neighbours=neighbours,
    )  # fmt: skip
