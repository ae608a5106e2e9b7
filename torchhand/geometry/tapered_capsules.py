"""How deep two tapered capsules (the hulls of two balls each) reach into each other, in closed form."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.precision import own_precision

_TINY = 1e-12
_NOTHING = 1e-18  # square metres: keeps the slope finite where two centres coincide
_STEEPEST = 0.99  # taper (change of radius over length) beyond which a capsule counts as its larger ball's cone
_PARALLEL = 1e-6  # squared sine below which two axes count as parallel


@own_precision
def tapered_capsule_depth(
    first_start: Float[Tensor, "*#batch 3"],
    first_end: Float[Tensor, "*#batch 3"],
    first_radii: Float[Tensor, "*#batch 2"],
    second_start: Float[Tensor, "*#batch 3"],
    second_end: Float[Tensor, "*#batch 3"],
    second_radii: Float[Tensor, "*#batch 2"],
) -> Float[Tensor, "*batch"]:
    """Depth of the overlap: the largest sum of radii less distance over a ball of the one and a ball of the other.

    Negative where they are apart: minus the gap. A capsule is the union of the balls whose centre and radius run
    linearly from one end to the other. With centres p(s) and q(t), r(s) + r(t) − |p(s) − q(t)| is concave in (s, t), so
    its maximum is where the slope is zero, or else on one of the four edges of the unit square. The best (s, t) is held
    fixed in the derivative: the first one is exact, as the value does not depend on them there; the second is not.
    """
    s, t = tapered_capsule_touch(
        *(x.detach() for x in (first_start, first_end, first_radii, second_start, second_end, second_radii))
    )
    along, other = first_end - first_start, second_end - second_start
    lever = first_start - second_start + s[..., None] * along - t[..., None] * other
    rise, other_rise = first_radii[..., 1] - first_radii[..., 0], second_radii[..., 1] - second_radii[..., 0]
    radii = first_radii[..., 0] + s * rise + second_radii[..., 0] + t * other_rise
    return radii - (lever.square().sum(-1) + _NOTHING).sqrt()


def tapered_capsule_touch(
    first_start: Float[Tensor, "*#batch 3"],
    first_end: Float[Tensor, "*#batch 3"],
    first_radii: Float[Tensor, "*#batch 2"],
    second_start: Float[Tensor, "*#batch 3"],
    second_end: Float[Tensor, "*#batch 3"],
    second_radii: Float[Tensor, "*#batch 2"],
) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch"]]:
    """Where two capsules reach deepest into each other, or are nearest: the fractions of their axes, 0 to 1, at which
    the two balls of `tapered_capsule_depth` are."""
    along, other = first_end - first_start, second_end - second_start
    rise, other_rise = first_radii[..., 1] - first_radii[..., 0], second_radii[..., 1] - second_radii[..., 0]
    return _deepest(first_start - second_start, along, other, rise, other_rise)


def _deepest(w: Tensor, u: Tensor, v: Tensor, rise_u: Tensor, rise_v: Tensor) -> tuple[Tensor, Tensor]:
    """(s, t) in the unit square with the largest rise_u s + rise_v t − |w + s u − t v|."""
    ww, wu, wv, uv = (w * w).sum(-1), (w * u).sum(-1), (w * v).sum(-1), (u * v).sum(-1)
    uu, vv = (u * u).sum(-1).clamp_min(_TINY), (v * v).sum(-1).clamp_min(_TINY)
    zero = torch.zeros_like(ww + uu + vv)
    one = zero + 1
    # The four edges of the square, s = 0 and 1, then t = 0 and 1, worked out together; the middle goes first.
    edges = [
        (ww, wv, vv, rise_v),
        (ww + 2 * wu + uu, wv + uv, vv, rise_v),
        (ww, -wu, uu, rise_u),
        (ww - 2 * wv + vv, uv - wu, uu, rise_u),
    ]
    along = _on_edge(*(torch.stack([x.expand_as(zero) for x in own]) for own in zip(*edges, strict=True)))
    middle = _between(ww, uu, vv, wu, wv, uv, rise_u, rise_v)
    s = torch.stack((middle[0].expand_as(zero), zero, one, along[2], along[3]))
    t = torch.stack((middle[1].expand_as(zero), along[0], along[1], zero, one))
    square = ww + s * (s * uu + 2 * wu) + t * (t * vv - 2 * wv) - 2 * s * t * uv
    value = rise_u * s + rise_v * t - square.clamp_min(0).sqrt()
    best = value.nan_to_num(nan=-torch.inf, neginf=-torch.inf).argmax(0, keepdim=True)
    return s.gather(0, best)[0], t.gather(0, best)[0]


def _on_edge(square: Tensor, dot: Tensor, length2: Tensor, rise: Tensor) -> Tensor:
    """t in [0, 1] with the largest rise · t − |x − t v|, from |x|², x · v, |v|²: the foot of x, moved by the taper."""
    taper = rise / length2.sqrt()
    taper2 = taper.square().clamp_max(_STEEPEST**2)
    distance2 = (square - dot * dot / length2).clamp_min(0)
    return (dot / length2 + (distance2 / (length2 * (1 - taper2))).sqrt() * taper).clamp(0, 1)


def _between(
    ww: Tensor, uu: Tensor, vv: Tensor, wu: Tensor, wv: Tensor, uv: Tensor, rise_u: Tensor, rise_v: Tensor
) -> tuple[Tensor, Tensor]:
    """(s, t) where the slope is zero on the whole lines, brought into the unit square.

    There the connection x = w + s u − t v has x · û = a |x| and x · v̂ = −b |x| with the tapers a and b.
    """
    length_u, length_v = uu.sqrt(), vv.sqrt()
    a, b = rise_u / length_u, rise_v / length_v
    p, q, g = wu / length_u, wv / length_v, uv / (length_u * length_v)
    sine2 = (1 - g * g).clamp_min(_PARALLEL)
    in_plane = ((a * a + 2 * g * a * b + b * b) / sine2).clamp_max(_STEEPEST**2)
    distance2 = (ww - (p * p - 2 * g * p * q + q * q) / sine2).clamp_min(0)
    distance = (distance2 / (1 - in_plane)).sqrt()
    sigma = ((a + g * b) * distance - p + g * q) / sine2
    tau = g * sigma + b * distance + q
    return (sigma / length_u).clamp(0, 1), (tau / length_v).clamp(0, 1)
