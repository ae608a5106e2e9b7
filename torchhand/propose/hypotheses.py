"""Using the network: silhouettes and cameras in, several weighted hands in the world for each out."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor
from torch.nn import functional

from torchhand.devices import constant_tensor
from torchhand.geometry import Camera
from torchhand.hand import HandKinematics, HandPose
from torchhand.image import depth_map
from torchhand.propose.channels import network_channels
from torchhand.propose.network import ProposalNetwork, ViewedHands
from torchhand.propose.views import SIDE_PX, SquareViews, palm_middle, views_towards

_FINE = 3  # samples along each side of a pixel of a view
_MARGIN = 1.1  # of the square about a whole silhouette, over the silhouette
_DISC_REACH = 4.0  # half the square about a palm, over the radius of the largest disc in the silhouette
_THICKEST = 0.98  # of the largest disc's radius: middles of other discs that count, so that ties do not decide
_CLOSER = 1.25  # of the square about a proposed hand, over the box of its keypoints
_SKIN = 0.1  # of the hand's length: what the skin adds to that box
_ALIKE = 0.08  # of the hand's length: mean distance of keypoints below which two hypotheses are one
_GREY = (0.299, 0.587, 0.114)  # of red, green, blue
_FAR = 1e4


@dataclass(frozen=True, kw_only=True)
class Silhouette:
    """What one picture shows of one hand."""

    mask: Bool[Tensor, "height width"]
    """Silhouette of the hand; a forearm may be part of it."""
    camera: Camera
    """A pinhole camera, which may distort."""
    image: UInt8[Tensor, "height width 3"] | None = None
    """The picture, RGB; its grey levels help where they are there."""


@dataclass(frozen=True, kw_only=True)
class HandHypotheses:
    """Several hands for each silhouette, the likeliest first."""

    pose: HandPose
    """Poses (silhouettes, k) in the world, with zero rotation vectors, in the dtype of the kinematics."""
    weight: Float[Tensor, "silhouettes k"]
    """Probabilities, which add up to 1; NaN, as the poses, where a silhouette is empty."""


def propose_hands(
    network: ProposalNetwork,
    silhouettes: Sequence[Silhouette],
    kinematics: HandKinematics,
    shape: Float[Tensor, "shape"] | None = None,
    *,
    count: int = 8,
) -> HandHypotheses:
    """The `count` likeliest hands behind each silhouette, in any posture and direction; side and size are those of the
    kinematics and the shape.

    The network first sees the whole silhouette and the surroundings of its thickest part, upright and upside down; then
    the hands that it proposed there, each in a closer view that holds it upright. Left hands are seen in the mirror.
    Hypotheses that are almost the same are joined. Raises ValueError for a camera that is no pinhole camera.
    """
    views = [_first_views(one) for one in silhouettes]
    given = [(i, own) for i, own in enumerate(views) if own is not None]
    like = kinematics.default_shape
    shape = like if shape is None else shape.to(like)
    dofs = like.new_full((len(silhouettes), count, 36), torch.nan)
    reference = like.new_full((len(silhouettes), count, 3, 3), torch.nan)
    weight = like.new_full((len(silhouettes), count), torch.nan)
    if given:
        some = [silhouettes[i] for i, _ in given]
        first = _SeenHands.of(network, some, _stacked([own for _, own in given]), kinematics, shape)
        found = _SeenHands.of(network, some, first.closer_views(), kinematics, shape)
        rows = torch.tensor([i for i, _ in given], device=like.device)
        dofs[rows], reference[rows], weight[rows] = found.likeliest(count)
    return HandHypotheses(pose=HandPose(dofs=dofs, reference=reference), weight=weight)


@dataclass(frozen=True, kw_only=True)
class _SeenHands:
    """What the network makes of some views of each silhouette, in the cameras' frames."""

    silhouettes: Sequence[Silhouette]
    joints: Float[Tensor, "n views k 30"]
    rotation: Float[Tensor, "n views k 3 3"]
    """cam_from_hand"""
    keypoints: Float[Tensor, "n views k 21 3"]
    root: Float[Tensor, "n views k 3"]
    weight: Float[Tensor, "n views k"]
    length: Float[Tensor, ""]
    """Length of the hand, metres."""

    @classmethod
    def of(
        cls,
        network: ProposalNetwork,
        silhouettes: Sequence[Silhouette],
        views: SquareViews,
        kinematics: HandKinematics,
        shape: Float[Tensor, "shape"],
    ) -> "_SeenHands":
        """views: (silhouettes, views)"""
        batch, like = views.reach.shape, kinematics.default_shape
        channels = torch.cat([sampled_channels(one, views[i]) for i, one in enumerate(silhouettes)])
        is_left = kinematics.side == "left"
        with torch.no_grad():
            found = network(channels.flip(-1) if is_left else channels)
        found = mirrored_hands(found) if is_left else found
        joints, turn, place, size, weight = (
            getattr(found, name).unflatten(0, batch).to(like)
            for name in ("joints", "rotation", "place", "log_size", "log_weight")
        )
        length = shape[kinematics.shape_space.names.index("hand_length")]
        reach, cam_from_view = views.reach.to(like)[..., None], views.cam_from_view.to(like)[..., None, :, :]
        depth = length / reach * torch.exp(-size)
        at_palm = torch.cat((place * reach[..., None], torch.ones_like(place[..., :1])), -1) * depth[..., None]
        rotation = cam_from_view @ turn
        still = torch.cat((joints.new_zeros(*joints.shape[:-1], 6), joints), -1)
        points = kinematics(still, shape, root_reference=rotation).keypoints
        root = (cam_from_view @ at_palm[..., None]).squeeze(-1) - palm_middle(points)
        return cls(
            silhouettes=silhouettes,
            joints=joints,
            rotation=rotation,
            keypoints=points + root[..., None, :],
            root=root,
            weight=weight.exp() / batch[1],
            length=length,
        )

    def closer_views(self) -> SquareViews:
        """A view of the likeliest hand of each view, upright."""
        best = self.weight.argmax(-1)
        return views_of_hands(_chosen(self.keypoints, best), _chosen(self.rotation, best)[..., 1], self.length)

    def likeliest(self, count: int) -> tuple[Tensor, Tensor, Tensor]:
        """Poses in the world and their weights, those that are alike joined."""
        points, weight = self.keypoints.flatten(1, 2), self.weight.flatten(1, 2)
        joined = [_joined(*one, _ALIKE * self.length, count) for one in zip(points, weight, strict=True)]
        chosen, weights = (torch.stack(part) for part in zip(*joined, strict=True))
        root, rotation, joints = (_picked(x.flatten(1, 2), chosen) for x in (self.root, self.rotation, self.joints))
        moved = []
        for camera, at, turn in zip([one.camera for one in self.silhouettes], root, rotation, strict=True):
            world_from_cam, place = camera.rotation.to(at).mT, camera.translation.to(at)
            moved.append(((at - place) @ world_from_cam.mT, world_from_cam @ turn))
        place, reference = (torch.stack(part) for part in zip(*moved, strict=True))
        return torch.cat((place, torch.zeros_like(place), joints), -1), reference, weights


def views_of_hands(
    points: Float[Tensor, "*batch 21 3"], fingers: Float[Tensor, "*batch 3"], length: Float[Tensor, ""]
) -> SquareViews:
    """A view of each hand that it fills, upright.

    points: keypoints in the camera's frame. fingers: direction there from the wrist to the fingers. length: of the
    hand, metres.
    """
    points = torch.cat((points[..., :2], points[..., 2:].clamp_min(0.02)), -1)
    middle = points.mean(-2)
    turned = views_towards(middle, fingers, torch.ones_like(middle[..., 0])).cam_from_view
    seen = points @ turned
    plane = seen[..., :2] / seen[..., 2:].clamp_min(0.02)
    low, high = plane.amin(-2), plane.amax(-2)
    centre = torch.cat((0.5 * (low + high), torch.ones_like(low[..., :1])), -1)
    half = 0.5 * (high - low).amax(-1) + _SKIN * length / middle[..., 2].clamp_min(0.02)
    at = (turned @ centre[..., None]).squeeze(-1)
    found = views_towards(at, fingers, _CLOSER * half)
    return SquareViews(cam_from_view=found.cam_from_view.float(), reach=found.reach.float())


def sampled_channels(silhouette: Silhouette, views: SquareViews) -> Float[Tensor, "views channels side side"]:
    """What the network sees of a picture in some views."""
    mask, camera = silhouette.mask, silhouette.camera
    plane = views.plane(_FINE * SIDE_PX)
    pixels = camera.to(dtype=torch.float32).pixels_from_plane(plane)
    rows, columns = _seen_part(pixels, mask, is_straight=not camera.has_distortion)
    mask, image = mask[rows, columns], silhouette.image
    device = mask.device
    if image is None:
        grey = torch.full(mask.shape, 0.5, device=device)
    else:
        grey = image[rows, columns].float() @ constant_tensor(_GREY, torch.float32, device) / 255
    height, width = mask.shape
    # From pixels of the part to -1..1 between its outer edges.
    size = torch.tensor((width, height), device=device)
    start = torch.tensor((columns.start, rows.start), device=device)
    grid = torch.addcmul((1 - 2 * start) / size - 1, pixels, 2 / size)
    if camera.has_distortion or camera.has_skew:  # what is behind the camera is not far away there
        grid = torch.where(plane.abs().amax(-1, keepdim=True) < _FAR, grid, _FAR)
    grid = grid.clamp_(-_FAR, _FAR)
    picture = torch.stack((mask.float(), grey, torch.ones_like(grey))).expand(len(grid), -1, -1, -1)
    fine = functional.grid_sample(picture, grid, mode="bilinear", padding_mode="zeros", align_corners=False)
    share, level, known = functional.avg_pool2d(fine, _FINE).unbind(1)
    return network_channels(share, level, known)


def _seen_part(
    pixels: Float[Tensor, "views rows columns 2"], mask: Tensor, *, is_straight: bool
) -> tuple[slice, slice]:
    """Rows and columns of a picture that hold all that is sampled of it; some where nothing is.

    is_straight: lines of the view are lines of the picture, so that the view's corners hold all of it.
    """
    height, width = mask.shape
    corners = pixels[:, :: pixels.shape[1] - 1, :: pixels.shape[2] - 1]
    if is_straight and bool(corners.isfinite().all()):
        pixels = corners
    inside = pixels.nan_to_num(0.0, posinf=_FAR, neginf=-_FAR).flatten(0, -2)
    low, high = inside.amin(0).floor() - 1, inside.amax(0).ceil() + 2
    left, right = (int(x.clamp(0, width)) for x in (low[0], high[0]))
    top, bottom = (int(x.clamp(0, height)) for x in (low[1], high[1]))
    if right <= left or bottom <= top:
        return slice(0, height), slice(0, width)
    return slice(top, bottom), slice(left, right)


def _first_views(silhouette: Silhouette) -> SquareViews | None:
    """The whole silhouette and the surroundings of its thickest part, upright and upside down; None of an empty one."""
    mask, camera = silhouette.mask, silhouette.camera
    if camera.kind != "pinhole":
        raise ValueError(f"camera: expected a pinhole camera, got {camera.kind}")
    if not bool(mask.any()):
        return None
    rows, columns = mask.any(1).nonzero()[:, 0], mask.any(0).nonzero()[:, 0]
    top, bottom, left, right = (int(end) for end in (rows[0], rows[-1], columns[0], columns[-1]))
    whole = (0.5 * (left + right), 0.5 * (top + bottom), _MARGIN * 0.5 * (max(right - left, bottom - top) + 1))
    inscribed = depth_map(mask, is_border_outside=True)
    radius = float(inscribed.max())
    y, x = (inscribed >= _THICKEST * radius).nonzero().double().mean(0).tolist()
    palm = (x, y, min(_DISC_REACH * radius, whole[2]))
    exact = camera.to(dtype=torch.float64)
    squares = torch.tensor((whole, palm, whole, palm), dtype=torch.float64, device=mask.device)
    ends = torch.stack(
        [squares[:, :2] + squares[:, 2:] * shift for shift in squares.new_tensor(((0, 0), (1, 0), (0, 1)))]
    )
    plane = exact.plane_from_pixels(ends)
    centre = torch.cat((plane[0], torch.ones_like(plane[0, :, :1])), -1)
    reach = 0.5 * (plane[1:] - plane[0]).norm(dim=-1).sum(0) / centre.norm(dim=-1)
    up = squares.new_tensor(((0, -1, 0), (0, -1, 0), (0, 1, 0), (0, 1, 0)))
    found = views_towards(centre, up, reach)
    return SquareViews(cam_from_view=found.cam_from_view.float(), reach=found.reach.float())


def _stacked(views: Sequence[SquareViews]) -> SquareViews:
    return SquareViews(
        cam_from_view=torch.stack([one.cam_from_view for one in views]),
        reach=torch.stack([one.reach for one in views]),
    )


def mirrored_hands(found: ViewedHands) -> ViewedHands:
    """The left hands whose mirror images in the view's plane x = 0 are given."""
    device = found.rotation.device
    across, in_hand = (constant_tensor(x, torch.float32, device) for x in ((-1.0, 1.0, 1.0), (1.0, 1.0, -1.0)))
    return ViewedHands(
        rotation=across[:, None] * found.rotation * in_hand,
        joints=found.joints,
        place=found.place * across[:2],
        log_size=found.log_size,
        spread=found.spread,
        log_weight=found.log_weight,
    )


def _joined(
    points: Float[Tensor, "m 21 3"], weight: Float[Tensor, "m"], near: Tensor, count: int
) -> tuple[Int[Tensor, "count"], Float[Tensor, "count"]]:
    """The likeliest hypotheses when each takes the weight of those near it; fewer ones are filled up with the rest."""
    apart = (points[:, None] - points).norm(dim=-1).mean(-1)
    left, rows, weights = weight.clone(), [], []
    for _ in range(min(count, len(weight))):
        best = int(left.argmax())
        is_near = (apart[best] < near) & (left >= 0)
        rows.append(best)
        weights.append(left[is_near].sum())
        left[is_near] = -1
        if not bool((left >= 0).any()):
            break
    spare = [i for i in weight.argsort(descending=True).tolist() if i not in rows]
    missing = count - len(rows)
    rows += (spare + rows * count)[:missing]
    total = torch.stack(weights + [weight.new_zeros(())] * missing)
    order = total.argsort(descending=True)
    return torch.tensor(rows, device=weight.device)[order], (total / total.sum())[order]


def _chosen(values: Tensor, index: Int[Tensor, "n views"]) -> Tensor:
    """One hypothesis of each view."""
    return values[torch.arange(len(index))[:, None], torch.arange(index.shape[1]), index]


def _picked(values: Tensor, index: Int[Tensor, "n k"]) -> Tensor:
    return values[torch.arange(len(index))[:, None], index]
