"""Light of a lamp by the Monte Carlo walk of `referees.transport`, for the referee of lamps.

The veil: photons are traced backwards from the camera along z through endless homogeneous water, in
scattering lengths, and joined at each scattering to every lamp by the phase function, the inverse
square and what is left over that way (next-event estimation). The plane at z: photons are traced
forwards from a lamp, and where they land gives the plane's irradiance by the distance from the
point below the lamp; what lands there from the camera is weighed with it. Values are as in the
model: 1 is a white plate that gets the irradiance of a lamp at distance 1. The plane sends back
what it gets once: the model has no light between surfaces.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from referees.transport import Array, henyey_greenstein, turn

ASYMMETRY = 0.924
RADIUS = 0.02  # of the lamps, in scattering lengths
_TOGETHER = 20_000
_FARTHEST = 25.0  # scattering lengths of a path; beyond, a = 0.1 b leaves 8 % of 1 in 1000


@dataclass(frozen=True)
class Truth:
    """What a camera sees of a lamp; each (lamps, absorptions).

    Attributes:
        direct: from the plane, unscattered on its way to the camera.
        forward: from the plane, scattered on that way.
        veil: without the plane.
        once: what of the veil was scattered once.
        error: standard error of the sum, relative.
    """

    direct: Array
    forward: Array
    veil: Array
    once: Array
    error: Array


class _Lamps:
    """Isotropic lamps beside the camera, and waters of several a/b."""

    def __init__(self, offsets: Sequence[float], absorption: Sequence[float]) -> None:
        self.offsets, self.absorption = np.array(offsets), np.array(absorption)

    def reached(self, at: Array, path: Array) -> tuple[Array, Array]:
        """Unit vectors (3, lamps, N) from points (3, N) to the lamps, and what arrives of their
        light after that and a path (lamps, absorptions, N).
        """
        way = np.zeros((3, len(self.offsets), at.shape[1]))
        way[0] = self.offsets[:, None] - at[0]
        way[1:] = -at[1:, None]
        squared = (way**2).sum(0) + RADIUS**2
        metres = np.sqrt(squared)
        left = np.exp(-metres - np.log(squared))[:, None]
        lost = np.exp(-self.absorption[:, None] * (metres + path)[:, None])
        return way / metres, left * lost


def lamp_light(
    lengths: float,
    offsets: Sequence[float],
    absorption: Sequence[float],
    photons: int,
    seed: int = 0,
) -> Truth:
    """Trace photons to a plane at `lengths` = b·z, for lamps at (offset, 0, 0)."""
    rng = np.random.default_rng(seed)
    lamps = _Lamps(offsets, absorption)
    runs = [_run(lamps, lengths, rng) for _ in range(max(2, photons // _TOGETHER))]
    stack = np.stack(runs)  # (runs, 4, lamps, absorptions)
    mean, total = stack.mean(0), stack[:, :3].sum(1)
    error = total.std(0, ddof=1) / np.sqrt(len(runs)) / np.maximum(total.mean(0), 1e-30)
    direct, forward, veil, once = mean
    return Truth(direct, forward, veil, once, error)


def _run(lamps: _Lamps, lengths: float, rng: np.random.Generator) -> Array:
    """Direct, forward, veil and what of it was scattered once, of one lot of photons."""
    n = _TOGETHER
    gets = _irradiance(lamps, lengths, rng)
    alone = np.exp(-(1 + lamps.absorption) * lengths)  # of the way to the camera
    direct = alone * np.stack([gets(np.array([offset]))[:, 0] for offset in lamps.offsets])
    # each is made to scatter before the plane
    path = -np.log1p(rng.random(n) * np.expm1(-lengths))
    at, to = np.zeros((3, n)), np.zeros((3, n))
    at[2], to[2] = path, 1.0
    share = -np.expm1(-lengths) / n
    veil, landed, first = _scattering(lamps, at, to, path, lengths, rng)
    points = np.concatenate([one for one, _ in landed], 1)
    lost = np.exp(-lamps.absorption[:, None] * np.concatenate([paths for _, paths in landed]))
    forward = np.zeros_like(direct)
    for i, offset in enumerate(lamps.offsets):
        forward[i] = (gets(np.hypot(points[0] - offset, points[1])) * lost).sum(-1)
    return np.stack([direct, share * forward, share * veil, share * first])


def _irradiance(
    lamps: _Lamps, lengths: float, rng: np.random.Generator
) -> Callable[[Array], Array]:
    """The irradiance of a plane (absorptions, N), by the distance from the point below a lamp: as
    the share of what it would be in vacuum, which changes slowly.
    """
    n = 2 * _TOGETHER
    cosine, turned = rng.uniform(-1, 1, n), rng.uniform(0, 2 * np.pi, n)
    sine = np.sqrt(1 - cosine**2)
    to = np.stack([sine * np.cos(turned), sine * np.sin(turned), cosine])
    path = rng.exponential(size=n)
    straight = path * cosine >= lengths
    way = lengths / np.maximum(cosine, 1e-12)
    landed = [((way * to)[:, straight], way[straight])]
    rest = ~straight
    _, more, _ = _scattering(None, (path * to)[:, rest], to[:, rest], path[rest], lengths, rng)
    landed += more
    points = np.concatenate([one for one, _ in landed], 1)
    paths = np.concatenate([one for _, one in landed])
    edges = lengths * np.tan(np.linspace(0, 1.5, 31))
    vacuum = 1 - 1 / np.hypot(edges / lengths, 1)  # of the half of the photons that go down
    rings = np.diff(vacuum) * n / 2
    shares = []
    for a in lamps.absorption:
        light, _ = np.histogram(np.hypot(points[0], points[1]), edges, weights=np.exp(-a * paths))
        shares.append(light / rings)
    middle = np.arctan(edges / lengths)
    middle = (middle[1:] + middle[:-1]) / 2

    def gets(distance: Array) -> Array:
        angle = np.arctan(distance / lengths)
        rows = [np.interp(angle, middle, share) for share in shares]
        found: Array = np.stack(rows) * (np.cos(angle) ** 3 / lengths**2)
        return found

    return gets


def _scattering(
    lamps: _Lamps | None,
    at: Array,
    to: Array,
    path: Array,
    lengths: float,
    rng: np.random.Generator,
) -> tuple[Array, list[tuple[Array, Array]], Array]:
    """Photons that scatter at points: what lamps, if any, send along their ways back (lamps,
    absorptions); where they land on the plane, after which paths; and what came of the first
    scattering.
    """
    sample = henyey_greenstein(ASYMMETRY).sample
    total = np.zeros((1, 1))
    first: Array | None = None
    landed = []
    g = ASYMMETRY
    while path.size:
        if lamps is not None:
            way, left = lamps.reached(at, path)
            cosine = np.einsum("iln,in->ln", way, to)
            phase = 0.25 * (1 - g * g) / (1 + g * g - 2 * g * cosine) ** 1.5
            total = total + (left * phase[:, None]).sum(-1)
        first = total if first is None else first
        turned = sample(rng.random(path.size))
        to = turn(to, *turned, rng.uniform(0, 2 * np.pi, path.size))
        step = rng.exponential(size=path.size)
        ends = at[2] + step * to[2] >= lengths
        rest = (lengths - at[2, ends]) / np.maximum(to[2, ends], 1e-12)
        landed.append((at[:, ends] + rest * to[:, ends], path[ends] + rest))
        goes = ~ends & (path + step < _FARTHEST)
        at, to, path = (at + step * to)[:, goes], to[:, goes], (path + step)[goes]
    return total, landed, total if first is None else first
