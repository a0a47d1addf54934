"""What acts on every frame, part by part: the machine's own weight, more of it, what is at the sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ppshw.kinematics import frames
from ppshw.statics import gravity_in_sensor, link_wrenches
from ppshw.terms.history import UNSEEN, payloads, weighs
from ppshw.terms.shapes.context import Context

Array = NDArray[np.float64]
AS_BUILT = 10.0  # of log evidence: 35 to 126 in twenty recordings whose simulated sensors read so
NO_NOISE_N = 1e-3  # of a force, at least
LEAST_WEIGHED = 8  # visits of a load label: three of them say what a payload is, the others whether they agree


def own_weight(c: Context, frame: int, component: int) -> Array:
    """A component of the wrench on a frame by the machine's own bodies alone."""
    return np.asarray(own_wrenches(c)[:, frame, component])


def own_bend(c: Context, frame: int) -> Array:
    """Deflection of one frame by the machine's own bodies alone, as stiff as the calibration has it."""
    out = np.zeros_like(c.wrenches)
    out[:, frame] = np.einsum("nab,nb->na", c.compliance[:, frame], own_wrenches(c)[:, frame])
    return out


def hanging(c: Context, frame: int, component: int, joint: int) -> Array:
    """Moment on a frame by a weight of 1 N that hangs at joint `joint` and grows with its travel (a cable chain)."""
    arm = c.chain[:, joint + 1, :3, 3] - c.chain[:, frame, :3, 3]
    g = np.asarray(c.machine.gravity) / max(float(np.linalg.norm(c.machine.gravity)), 1e-9)
    force = (0.5 + 0.5 * c.u(joint))[:, None] * g
    return np.asarray(turned(c.chain[:, frame], force, np.cross(arm, force))[:, component])


def body_weight(c: Context, joint: int, what: str, grows: int = 0, by: int | None = None) -> Array:
    """Deflection by 1 kg more on a joint's body ("mass"), or by 1 kg·m of shifted mass ("x", "y", "z").

    grows  what hangs there goes with that power of a joint's position, −1 … 1 over its travel: a cable chain
    by     of another joint's than its own: a hose that the other one pulls along
    """
    out = np.zeros_like(c.wrenches)
    g = c.machine.gravity
    pose = c.chain[:, joint + 1]
    com = c.machine.joints[joint].com
    for i in range(1, joint + 1 + (c.machine.bent_by != "beyond")):
        frame = c.chain[:, i]
        if what == "mass":
            force = np.broadcast_to(g, (len(out), 3))
            arm = np.einsum("nij,j->ni", pose[:, :3, :3], com) + pose[:, :3, 3] - frame[:, :3, 3]
            moment = np.cross(arm, force)
        else:
            force = np.zeros((len(out), 3))
            axis = pose[:, :3, "xyz".index(what)]
            moment = np.cross(axis, np.broadcast_to(g, (len(out), 3)))
        out[:, i] = np.einsum("nab,nb->na", c.compliance[:, i], turned(frame, force, moment))
    return np.asarray(out * (c.u(joint if by is None else by) ** grows)[:, None, None]) if grows else out


def turned(frame: Array, force: Array, moment: Array) -> Array:
    """Force and moment (N, 3) from base axes into a frame's: (N, 6)."""
    into = np.swapaxes(frame[:, :3, :3], 1, 2)
    return np.concatenate([(into @ force[..., None])[..., 0], (into @ moment[..., None])[..., 0]], axis=1)


def own_wrenches(c: Context) -> Array:
    """(N, n+1, 6) on every frame by the machine's own bodies, whether they are known to bend it or not."""
    machine = replace(c.machine, bent_by="own") if c.machine.bent_by == "payload" else c.machine
    return c.once(("own",), lambda: link_wrenches(machine, c.chain, np.zeros((len(c.chain), 6))))


def payload_wrenches(c: Context) -> Array:
    """(N, n+1, 6) on every frame by the payload alone."""
    return c.wrenches if c.machine.bent_by == "payload" else c.wrenches - own_wrenches(c)


def payloads_of(c: Context) -> Array:
    """(N, 4) mass [kg] and first moment [kg·m] of what hangs at the sensor: see `payloads`."""
    return c.once(("payloads",), lambda: payloads(c.recording.wrench, c.recording.load, gravity_at_sensor(c)))


def beside_the_payload(c: Context) -> Array:
    """(N, 6) what the sensor read beside what the rigid payload of each load label weighs there [N, N m]; nothing of
    labels that few visits weighed, or none."""

    def make() -> Array:
        beside = c.recording.wrench - weighs(payloads_of(c), gravity_at_sensor(c))
        return np.asarray(beside * weighed_often(c)[:, None])

    return c.once(("beside the payload",), make)


def weighed_often(c: Context) -> NDArray[np.bool_]:
    """(N,) whose load enough visits weighed."""
    labels, at, count = np.unique(np.array(c.recording.load), return_inverse=True, return_counts=True)
    return np.asarray(((count >= LEAST_WEIGHED) & (labels != ""))[at])


def gravity_at_sensor(c: Context) -> Array:
    """(N, 3) in the sensor frame [m/s²], in the pose that the wrench was read in."""
    return c.once(("gravity at the sensor",), lambda: gravity_in_sensor(c.machine, chain_as_read(c)))


def chain_as_read(c: Context) -> Array:
    """(N, n+1, 4, 4) the chain as what hangs there was read in: as it bends, as sensors have it, but where the readings
    of rigid payloads surely say that it is as built, as where somebody worked them out from masses that he knows."""
    built = frames(c.machine, c.recording.q)
    return built if c.frozen("read as built", _says_as_built(c, built)) > AS_BUILT else c.chain


def _says_as_built(c: Context, built: Array) -> float:
    """Log evidence of the forces for having been read in the pose as built, whatever zeros and gains the sensor has."""
    labels, often = np.array(c.recording.load), weighed_often(c)
    bent, straight = (gravity_in_sensor(c.machine, chain) for chain in (c.chain, built))
    out = 0.0
    for label in dict.fromkeys(labels[often].tolist()):
        mine = labels == label
        left = []
        for gravity in (bent[mine], straight[mine]):
            by = np.column_stack([np.ones(len(gravity)), gravity])
            force = c.recording.wrench[mine, :3]
            beside = force - by @ np.linalg.lstsq(by, force, rcond=UNSEEN)[0]
            left.append(np.maximum((beside**2).mean(axis=0), NO_NOISE_N**2))
        out += 0.5 * (int(mine.sum()) - 4) * float(np.log(left[0] / left[1]).sum())
    return out


def by_payload(c: Context, wrench: Array) -> Array:
    """(N, n+1, 6) on every frame by a wrench (N, 6) at the sensor alone."""
    return np.asarray(np.einsum("nfab,nb->nfa", _reaching(c), wrench))


def _reaching(c: Context) -> Array:
    """(N, n+1, 6, 6) what acts on every frame by a unit of every component at the sensor."""

    def make() -> Array:
        sensor = (c.chain[:, -1] @ c.machine.sensor_in_link)[:, None]
        into = np.swapaxes(c.chain[..., :3, :3], 2, 3)
        out = np.zeros((*c.chain.shape[:2], 6, 6))
        out[..., :3, :3] = out[..., 3:, 3:] = into @ sensor[..., :3, :3]
        arm = sensor[..., :3, 3] - c.chain[..., :3, 3]
        turns = np.cross(arm[:, :, None], np.swapaxes(sensor[..., :3, :3], 2, 3))  # arm × each axis of the sensor
        out[..., 3:, :3] = into @ np.swapaxes(turns, 2, 3)
        return out

    return c.once(("reaching",), make)


def deflection(c: Context, wrenches: Array) -> Array:
    """(N, n+1, 6) of every frame by wrenches (N, n+1, 6) on them, as stiff as the calibration has it."""
    return np.asarray(np.einsum("nfab,nfb->nfa", c.compliance, wrenches))


def expected_by(c: Context, wrench: Array) -> Array:
    """(N, n+1, 6) deflection of every frame that a wrench (N, 6) at the sensor would make."""
    given = c.once(("given",), lambda: np.asarray(c.compliance @ _reaching(c)))
    return np.asarray(np.einsum("nfab,nb->nfa", given, wrench))
