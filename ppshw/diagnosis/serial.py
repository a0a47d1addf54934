"""Noise of which each visit has some of the one before: how much, and which findings it may have made.

Visits at random poses hide it: the same slip of one joint moves the reflectors another way at every pose. So it is
looked for in the freedoms in which the machine scatters (every joint's, or the end effector's), by the score of a
correlation of consecutive visits (locally most powerful; Rao 1948):

    a_n = S^½ B_nᵀ R_n⁻¹ r_n,    Σ a_n·a_n₊₁

B: what a unit of every freedom does to a visit's readings, S: the freedoms' variances, R: the readings' covariance, r:
the residual. The fit takes what neighbours have in common, about half of it in a recording of 450 visits; so ρ is that
of noise of the model's own that leaves as much (indirect inference; Gouriéroux, Monfort & Renault 1993), and such noise
tells what the candidates would have said. Random signs of whole visits do not tell it, nor do those of runs of visits:
they begin with what the fit has left.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from ppshw.diagnosis.evidence import DRAWS, Tried, p_value
from ppshw.diagnosis.found import Found, take_up
from ppshw.diagnosis.workspace import Workspace

Array = NDArray[np.float64]
# Standard deviations from none: in 8 clean recordings of independent noise at most 1.5, of noise correlated by 0.35 6.6
# and more (seeds 81001 to 81008).
REMEMBERS = 3.5
BESIDE_MEMORY = 1e-3  # p of a finding beside noise that remembers
TRIED = np.arange(0.0, 0.9, 0.1)  # correlations that noise of the model's own is given
OF_NONE, OF_EACH = 100, 20  # draws of each


@dataclass(frozen=True)
class SerialNoise:
    """Noise in the freedoms in which the machine scatters, in the fit visits of a workspace.

    freedoms    (F, 3T, f) whitened readings of a unit of every freedom;  instrument (F, 3T, 3T) of the instrument's
    """

    freedoms: Array
    instrument: Array

    @staticmethod
    def of(space: Workspace) -> SerialNoise:
        noise, levers = space.base.noise, space.context.levers()[space.fit]
        root = noise.whitener(levers, space.recording.seen[space.fit])
        scatter = noise.scatter(levers.reshape(len(levers), space.rows, -1))
        return SerialNoise(root @ scatter, root * noise.instrument)

    def draws(self, correlation: float, count: int, rng: np.random.Generator) -> Array:
        """(count, F, 3T) whitened readings, of unit variance, where each visit's scatter has that correlation with the
        one before."""
        visits, rows, number = self.freedoms.shape
        fresh = rng.standard_normal((count, visits, number))
        fresh[:, 1:] *= np.sqrt(1.0 - correlation**2)
        scatter = lfilter([1.0], [1.0, -correlation], fresh, axis=1)
        white = rng.standard_normal((count, visits, rows))
        return np.asarray(
            np.einsum("nrf,dnf->dnr", self.freedoms, scatter) + np.einsum("nrs,dns->dnr", self.instrument, white)
        )

    def score(self, space: Workspace, readings: Array) -> Array:
        """(D,) of what the workspace's fit leaves of whitened readings (D, F, 3T)."""
        left = space.left_of(readings.reshape(len(readings), -1).T).T.reshape(readings.shape)
        along = np.einsum("nrf,dnr->dnf", self.freedoms, left)
        return np.asarray(np.einsum("dnf,dnf->d", along[:, 1:], along[:, :-1]))

    def correlation(self, space: Workspace, rng: np.random.Generator) -> float:
        """Of consecutive visits' scatter, by what is left beside all that was taken up; 0 where it may be chance."""
        observed = float(self.score(space, space.y.reshape(1, *self.freedoms.shape[:2]))[0])
        chance = self.score(space, self.draws(0.0, OF_NONE, rng))
        if observed <= chance.mean() + REMEMBERS * chance.std():
            return 0.0
        made = [chance.mean()]
        made += [self.score(space, self.draws(each, OF_EACH, rng)).mean() for each in TRIED[1:]]
        return float(np.interp(observed, np.maximum.accumulate(made), TRIED))


def sentence(answer: Mapping[str, Any]) -> str | None:
    """What a diagnosis's answer says of it, if anything."""
    value = answer.get("serial_correlation", 0.0)
    return f"noise remembers: a visit's scatter has {value:.2f} of that of the visit before" if value else None


def drop_what_noise_may_be(space: Workspace, tried: Tried, found: list[Found], rng: np.random.Generator) -> None:
    """Where noise remembers the visit before, findings are dropped that such noise makes too, the most quiet first; of
    the others p is by that noise where it is the larger."""
    if not found:
        return
    noise = SerialNoise.of(space)
    after = noise.correlation(space, rng)
    if after == 0.0:
        return
    for f in sorted(found, key=lambda f: f.first):
        others = [g for g in found if g is not f]
        take_up(space, tried, others)
        said = float(tried.said()[1][tried.names.index(f.name)])
        # what was taken up has some of the noise's own slow part, what was not may be none of it: between the two
        between = 0.5 * (after + noise.correlation(space, rng))
        p = p_value(said, tried.greatest(noise.draws(between, DRAWS, rng)))
        if p > BESIDE_MEMORY:
            found.remove(f)
        else:
            f.p = max(f.p, p)
    take_up(space, tried, found)
