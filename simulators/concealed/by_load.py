"""What depends on the load: springs that are not straight, play under a moment, own weight, creep, sensors that err."""

from __future__ import annotations

import numpy as np

from simulators import chain as kinematics
from simulators.chain import COMPONENTS as LOADS
from simulators.chain import Array
from simulators.concealed.scene import COMPONENTS, Change, Concealed, Scene


def nonlinear_stiffness(scene: Scene, rng: np.random.Generator) -> Concealed:
    """How far a link's sag departs from the straight line through nothing and the greatest load.

    contact    a bearing's balls flatten: sgn(M)|M|^p, p from 2/3 to 0.85           (Hertz)
    hardening  slack cables and preloaded joints: soft at first, then stiff;  softening: a preload that lifts off
    """
    k, part = _loaded(scene, rng, crossing=False)
    form = str(rng.choice(["contact", "hardening", "softening"]))
    greatest = np.abs(scene.carried[:, k, part]).max()
    # of hardening: the share of the greatest load at which it is half stiff
    between = {"contact": (2 / 3, 0.85), "hardening": (0.15, 0.4), "softening": (1.6, 3.0)}
    exponent = float(rng.uniform(*between[form]))

    def shape(s: Scene) -> Array:
        x = s.carried[:, k, part] / greatest
        if form == "hardening":
            return np.asarray(np.tanh(x / exponent) / np.tanh(1 / exponent) - x)
        return np.asarray(np.sign(x) * np.abs(x) ** exponent - x)

    name = scene.chain.joints[k].name
    return Concealed(
        scene, "nonlinear_stiffness", form, name, COMPONENTS[part], (LOADS[part],),
        lambda s, size: Change(eps=s.eps(k, size * shape(s)[:, None] * np.eye(6)[part])),
        lambda size: {"departure": size, "exponent": exponent},
    )  # fmt: skip


def clearance(scene: Scene, rng: np.random.Generator) -> Concealed:
    """A joint lies on one side of its play or the other, as the moment on it tells.

    smooth      tips over within a few per cent of the greatest moment
    asymmetric  tips over at a moment that is not zero (a seal pushes), farther to one side
    sticky      tips only when the moment exceeds a limit, and stays until it does the other way
    """
    k, part = _loaded(scene, rng, crossing=True)
    form = str(rng.choice(["smooth", "asymmetric", "sticky"]))
    greatest = np.abs(scene.carried[:, k, part]).max()
    width = float(rng.uniform(0.03, 0.1))
    preload, farther = (rng.uniform(-0.1, 0.1), rng.uniform(0.5, 0.8)) if form == "asymmetric" else (0.0, 1.0)

    def side(s: Scene) -> Array:
        x = s.carried[:, k, part] / greatest
        if form == "smooth":
            return np.asarray(np.tanh(x / width))
        if form == "asymmetric":
            tipped = (x - preload) / width
            return np.asarray(np.where(tipped > 0, 1.0, farther) * tipped / np.sqrt(1 + tipped**2))
        out, here = np.zeros(len(x)), float(np.sign(x[0]) or 1.0)
        for v, value in enumerate(x):
            here = float(np.sign(value)) if abs(value) > width else here
            out[v] = here
        return out

    name = scene.chain.joints[k].name
    return Concealed(
        scene, "clearance", form, name, COMPONENTS[part], (LOADS[part],),
        lambda s, size: Change(eps=s.eps(k, size / 2 * side(s)[:, None] * np.eye(6)[part])),
        lambda size: {"play": size, "width": width},
    )  # fmt: skip


def moving_weight(scene: Scene, rng: np.random.Generator) -> Concealed:
    """The machine's own bodies bend it otherwise than masses and springs of the file say.

    own bend     a link gives way under the weight of what it carries of the machine, by a spring of its own that the
                 payload, hung elsewhere, does not load (a couch guide, a bellows, a counterweight's lever)
    hanging      a cable chain whose hanging length, and weight, grows with the joint's travel, on the link before
    """
    chain = scene.chain
    form = str(rng.choice(["own bend", "hanging cable"]))
    own = scene.carried - scene.payload
    if form == "own bend":
        greatest = float(np.abs(own[..., 3:]).max())
        links = range(len(chain.joints))
        able = [(k, part) for k in links for part in (3, 4, 5) if own[:, k, part].std() > 0.05 * greatest]
        k, part = able[int(rng.integers(len(able)))]
        most = np.abs(own[:, k, part]).max()

        def shape(s: Scene) -> Array:
            return np.asarray((s.carried - s.payload)[:, k, part] / most)

    else:
        # hangs from the end of link `far`, one of those that are not on top of the link below; bends that one below
        arms = scene.poses[:, 1:, :3, 3] - scene.poses[:, :-1, :3, 3]
        level = np.linalg.norm(np.cross(arms, chain.gravity), axis=2).max(axis=0)
        far = 1 + int(rng.choice(np.flatnonzero(level > 0.3 * level.max())))
        growth = rng.uniform(1.0, 2.0)

        def turned(s: Scene) -> Array:
            hanging = np.clip(0.5 + 0.5 * s.unit_position(far), 0.0, 1.0) ** growth
            arm = s.poses[:, far, :3, 3] - s.poses[:, far - 1, :3, 3]
            moment = np.cross(arm, chain.gravity) * hanging[:, None]
            return np.asarray(np.einsum("nba,nb->na", s.poses[:, far - 1, :3, :3], moment))

        k, part = far - 1, 3 + int(np.argmax(turned(scene).std(axis=0)))
        most = np.abs(turned(scene)[:, part - 3]).max()

        def shape(s: Scene) -> Array:
            return np.asarray(turned(s)[:, part - 3] / most)

    moved = [chain.joints[j].name for j in range(k, len(chain.joints)) if np.ptp(scene.q[:, j]) > 0]
    return Concealed(
        scene, "moving_weight", form, chain.joints[k].name, COMPONENTS[part], tuple(f"q_{j}" for j in moved[:4]),
        lambda s, size: Change(eps=s.eps(k, size * shape(s)[:, None] * np.eye(6)[part])),
        lambda size: {"greatest_bend": size}, also=tuple(moved[1:2]),
    )  # fmt: skip


def wrench_error(scene: Scene, rng: np.random.Generator) -> Concealed:
    """The force sensor says something else than what acts; nothing moves, but the sag is not the one expected.

    gain        all six by one factor;   cross-talk: each force leaks into the moments
    warm zero   its zero follows the air, an hour behind, in all six
    """
    form = str(rng.choice(["gain", "cross-talk", "warm zero"]))
    reach = np.abs(scene.wrench).max(axis=0)
    reach = np.maximum(reach, 0.05 * np.repeat([reach[:3].max(), reach[3:].max()], 3))
    leak = rng.normal(size=(3, 3)) * reach[3:].max() / reach[:3].max() if form == "cross-talk" else np.zeros((3, 3))
    per_kelvin = reach * rng.normal(size=6) if form == "warm zero" else np.zeros(6)

    def shape(s: Scene) -> Array:
        if form == "gain":
            return s.wrench.copy()
        if form == "cross-talk":
            return np.hstack([np.zeros((len(s), 3)), s.wrench[:, :3] @ leak.T])
        warm = lagged(s.campaign.temperature["air"], s.campaign.time, 3600.0)
        return np.asarray((warm - warm[0])[:, None] * per_kelvin)

    sign = float(rng.choice([-1.0, 1.0]))
    covariate = "temp_air_C" if form == "warm zero" else LOADS[int(np.argmax(np.abs(shape(scene)).std(axis=0)))]
    return Concealed(
        scene, "wrench_error", form, None, None, (covariate,),
        lambda s, size: Change(wrench=sign * size * shape(s)), lambda size: {"relative": sign * size}, start=0.02,
    )  # fmt: skip


def creep(scene: Scene, rng: np.random.Generator) -> Concealed:
    """A link goes on sagging after the load has changed, and recovers when it is gone.

    two exponentials  minutes and a good part of an hour;   logarithmic: as steel cables and glued joints do
    viscous  dampers beside a part of the spring (Kelvin & Voigt): after every move that changes the moment, too

    The first two superpose loads (Boltzmann): what has not come yet of each former change of load, in the pose of now.
    """
    form = str(rng.choice(["two exponentials", "logarithmic", "viscous"]))
    fast, slow, share = rng.uniform(180, 600), rng.uniform(1200, 2700), rng.uniform(0.3, 0.7)
    start = rng.uniform(30, 120)

    def remaining(age: Array) -> Array:
        if form == "logarithmic":  # counted back from three hours, where the next load is long on
            return np.asarray(np.maximum(1 - np.log1p(age / start) / np.log1p(10800 / start), 0.0))
        return np.asarray(share * np.exp(-age / fast) + (1 - share) * np.exp(-age / slow))

    # the link's own spring, so that what creeps looks like what sags
    k, part = _loaded(scene, rng, crossing=False)
    most = np.abs(scene.payload[:, k, part]).max()

    def damped(s: Scene) -> Array:
        moment, c = s.payload[:, k, part], s.campaign
        moved = np.diff(c.time, prepend=c.time[0] - 400.0)
        out = np.zeros(len(c))
        for constant, part_of_it in ((fast, share), (slow, 1 - share)):
            bent = 0.0
            for v in range(len(c)):  # where it was until the axes are there, then the new moment
                there = min(moved[v], c.settle[v] + 25.0)
                bent += (moment[max(v - 1, 0)] - bent) * -np.expm1(-(moved[v] - there) / constant) if v else 0.0
                bent += (moment[v] - bent) * -np.expm1(-there / constant)
                out[v] += part_of_it * (moment[v] - bent)
        return np.asarray(out / most)

    def shape(s: Scene) -> Array:
        if form == "viscous":
            return damped(s)
        c = s.campaign
        held = np.column_stack([c.mass, c.mass[:, None] * c.com])  # what a load is at rest: mass and first moment
        missing = np.zeros_like(held)
        changes = np.flatnonzero(np.any(np.diff(held, axis=0) != 0, axis=1)) + 1
        for v in (0, *changes):
            before = np.zeros(4) if v == 0 else held[v - 1]
            # put on halfway between visits
            applied = c.time[v] - (180.0 if v == 0 else 0.5 * (c.time[v] - c.time[v - 1]))
            age = np.maximum(c.time[v:] - applied, 0.0)
            missing[v:] += (held[v] - before) * remaining(age)[:, None]
        force = np.einsum("nba,b->na", (s.poses[:, -1] @ s.chain.sensor)[:, :3, :3], s.chain.gravity)
        late = np.concatenate([missing[:, :1] * force, np.cross(missing[:, 1:], force)], axis=1)
        own = s.carried - s.payload
        on_links = kinematics.link_wrenches(s.chain, s.poses, late) - own
        return np.asarray(on_links[:, k, part] / most)

    name = scene.chain.joints[k].name
    return Concealed(
        scene, "creep", form, name, COMPONENTS[part], ("time", LOADS[part]),
        lambda s, size: Change(eps=s.eps(k, -size * shape(s)[:, None] * np.eye(6)[part])),
        lambda size: {"full_load_creep": size, "fast_s": float(fast), "slow_s": float(slow)},
    )  # fmt: skip


def missing_compliance(scene: Scene, rng: np.random.Generator) -> Concealed:
    """A spring that the machine file does not know: of a joint that it takes for rigid, or of the floor.

    A bearing ring whose rotations and translation give way in proportion, not equally in all directions.
    """
    on_floor = not scene.rigid
    k = 0 if on_floor else [j.name for j in scene.chain.joints].index(scene.rigid[0])
    soft = np.concatenate([rng.uniform(0.2, 1.0, 3) * 0.05, rng.uniform(0.5, 1.5, 3)])  # [m²] against rad/(N m)

    def load(s: Scene) -> Array:
        if not on_floor:
            return s.carried[:, k]
        # the wrench at the base's origin, in its axes: floor and anchors
        turn, at = s.poses[:, 0, :3, :3], s.poses[:, 0, :3, 3]
        force = np.einsum("nab,nb->na", turn, s.carried[:, 0, :3])
        moment = np.einsum("nab,nb->na", turn, s.carried[:, 0, 3:]) + np.cross(at, force)
        return np.concatenate([force, moment], axis=1)

    most = float(np.abs(load(scene)[:, 3:]).max())

    def bent(s: Scene, size: float) -> Change:
        shape = soft * load(s) / most
        return Change(base=size * shape) if on_floor else Change(eps=s.eps(k, size * shape))

    joint = None if on_floor else scene.chain.joints[k].name
    return Concealed(
        scene, "missing_compliance", "floor" if on_floor else "joint taken for rigid", joint, None, LOADS, bent,
        lambda size: {"compliance": size / most},
    )  # fmt: skip


def lagged(values: Array, time: Array, lag_s: float) -> Array:
    """First-order lag, step by step, at rest in the beginning."""
    out = values.copy()
    for v in range(1, len(values)):
        keep = np.exp(-(time[v] - time[v - 1]) / lag_s)
        out[v] = keep * out[v - 1] + (1 - keep) * values[v]
    return out


def _loaded(scene: Scene, rng: np.random.Generator, crossing: bool) -> tuple[int, int]:
    """A link and a component of its wrench that loads vary much, of those that the machine file lets act.

    crossing  True: among the moments that are of either sign in at least a sixth of the visits each
    """
    found = []
    for k, joint in enumerate(scene.chain.joints):
        greatest = np.repeat([np.abs(scene.carried[:, k, part]).max() for part in (slice(0, 3), slice(3, 6))], 3)
        for part in range(3, 6):
            load = scene.carried[:, k, part]
            both = min(float((load > 0).mean()), float((load < 0).mean()))
            varied = scene.payload[:, k, part].std() > 0.1 * greatest[part]
            if joint.acts[part] and varied and (both > 1 / 6 or not crossing):
                found.append((k, part))
    if not found:
        raise ValueError(f"{scene.chain.name}: no moment {'changes sign' if crossing else 'varies with the load'}")
    return found[int(rng.integers(len(found)))]
