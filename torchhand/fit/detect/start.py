"""Finds a hand in a single picture and fits it: the start of a track, and its restart after a loss."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeGuard

import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.devices import on_host
from torchhand.fit import Appearance, disc, learn_appearance, mask_plane
from torchhand.fit.contour import hand_length_px, is_in_picture
from torchhand.fit.detect.alignment import Alignment, align_points, align_posture
from torchhand.fit.detect.edge_fit import Fit, FitSettings, fit_contour, fit_contours
from torchhand.fit.detect.keypoint_cut import CutAtKeypoints
from torchhand.geometry import Camera
from torchhand.hand import DOFS, TIPS, HandKinematics, HandPose
from torchhand.image import (
    BackgroundPlate,
    SilhouetteSettings,
    bootstrap_skin,
    clean,
    enlarged_mask,
    fill_holes,
    hand_region,
    intersection_over_union,
    label_pieces,
    largest_component,
    segment,
    skin_candidates,
    skin_probability,
    touching,
)
from torchhand.view import HandProjector, OutlineTable

StartPoints = tuple[float, float, float, float]
"""Wrist x, y and middle fingertip x, y in px."""

_WORST_COST = 0.42  # alignments above it are not worth fitting
_TRIES = 4  # alignments fitted per picture
_SPREADS = (1.6, 0.4)  # factors on the abductions from which the fit starts too, as long as none is good
_GOOD = 0.93  # overlap at which no other start is tried
_NEAR = 0.65  # overlap below which other abductions are not tried: the hand has another posture or is elsewhere
_MIN_FOUND = 0.8  # share of the fitted contour that must lie on edges
_MIN_INSIDE = 0.8  # share of the keypoints that must lie in the picture
_WORST_OTHER = 0.30  # alignments with other pieces than the likeliest above it are not worth fitting
_GOOD_OTHER = 0.85  # overlap of a hand found in one of these, and share of its contour on edges, at least
_APART = 0.5  # of the distance between two fingertips in the posture
_MOST_OTHERS = 2  # pieces of the hand's colours beside the largest that are looked at
_SAME_PIECE = 0.9  # intersection over union of two pieces that are one
_MIN_AREA_FRACTION = 0.004  # share of the picture that a silhouette fills at least


@dataclass(frozen=True, kw_only=True)
class ContourFitter:
    """A hand before a camera, and how its contour is fitted to a picture."""

    kinematics: HandKinematics
    camera: Camera
    """Camera whose frame is the world."""
    table: OutlineTable
    shape: Float[Tensor, "shape"]
    """Proportions to start from, or known ones."""
    fit_shape: bool = True
    """Whether proportions are fitted; else `shape` is kept."""
    settings: FitSettings = field(default_factory=FitSettings)

    def fitted(self, mask: Bool[Tensor, "height width"], start: Fit) -> Fit:
        """The hand of `start` moved until its contour lies on that of the mask; see `fit_contour`."""
        projector = HandProjector(self.kinematics, self.camera, start.shape)
        pose = HandPose.of(start.pose, start.root_reference)
        return fit_contour(mask_plane(mask), projector, self.table, pose, self.settings, fit_shape=self.fit_shape)

    def fitted_each(self, mask: Bool[Tensor, "height width"], alignments: Sequence[Alignment]) -> Iterator[Fit]:
        """The hand moved so from each of some placements of one posture: all at once where the shape is known, else
        each when it is asked for."""
        if self.fit_shape or not alignments:
            starts = (Fit.of_start(one.pose, one.root_reference, self.shape) for one in alignments)
            yield from (self.fitted(mask, start) for start in starts)
            return
        poses = HandPose.stack([HandPose.of(one.pose, one.root_reference) for one in alignments])
        projector = HandProjector(self.kinematics, self.camera, self.shape)
        yield from fit_contours(mask_plane(mask), projector, self.table, poses, self.settings)

    def overlap(self, mask: Bool[Tensor, "height width"], fit: Fit) -> float:
        """Intersection over union of a fitted hand and a mask, forearm cut at the wrist."""
        return fit_overlap(mask, self.kinematics, self.camera, fit)

    def length_px(self, fit: Fit) -> float:
        """Length of a fitted hand that is held parallel to the picture."""
        return hand_length_px(self.camera, self.kinematics, fit.pose, fit.shape)


@dataclass(frozen=True, kw_only=True)
class Start:
    """A hand found in a picture."""

    fit: Fit
    appearance: Appearance | CutAtKeypoints
    overlap: float
    """Intersection over union of the fitted hand and the picture's, forearm cut at the wrist."""

    @property
    def quality(self) -> float:
        """Overlap, weighed down where the contour finds no edges."""
        return self.overlap * min(1.0, self.fit.found_fraction / _MIN_FOUND)


@dataclass(frozen=True, kw_only=True)
class NoStart:
    """Why a picture gave no hand."""

    reason: str
    has_foreground: bool
    """Whether something hand-coloured of a believable size is there."""


@dataclass(frozen=True, kw_only=True)
class _Piece:
    """A part of a picture that may be the hand."""

    image: UInt8[Tensor, "height width 3"]
    mask: Bool[Tensor, "height width"]
    rest: Bool[Tensor, "height width"]
    """What is neither the hand nor like it."""
    alignments: Sequence[Alignment]
    """Placements of the posture over it that are worth fitting, the best first."""

    @classmethod
    def of(cls, image: Tensor, mask: Tensor, rest: Tensor, posture: Tensor, fitter: ContourFitter) -> "_Piece":
        """None of the placements over a piece that is too small for a hand is worth fitting."""
        found: list[Alignment] = []
        if float(mask.float().mean()) >= _MIN_AREA_FRACTION:
            found = align_posture(mask, fitter.camera, fitter.kinematics, fitter.shape, posture)
        worth = [one for one in found if one.cost < _WORST_COST]
        return cls(image=image, mask=mask, rest=rest, alignments=worth[:_TRIES])

    @property
    def cost(self) -> float:
        """Of the best placement; infinite where none is worth fitting."""
        return min((one.cost for one in self.alignments), default=math.inf)


@on_host
def segment_hand(
    image: UInt8[Tensor, "height width 3"],
    appearance: Appearance | None,
    silhouette: SilhouetteSettings | None = None,
    plate: BackgroundPlate | None = None,
) -> tuple[Bool[Tensor, "height width"], str]:
    """Silhouette of hand and bare forearm, and why it is empty where it is.

    By the colours learned in this video where there are any; else by the method of `silhouette`: skin that the picture
    itself teaches, the difference from a plate of the empty scene, or a coloured screen.
    """
    if appearance is None and silhouette is not None and silhouette.method != "skin":
        mask = segment(image, silhouette, plate=plate)
        return mask, "" if bool(mask.any()) else f"nothing stands out of the {silhouette.method}"
    if appearance is None:
        start = bootstrap_skin(image)
        return start.mask, start.reason
    mask = fill_holes(largest_component(clean(appearance.probability(image) > 0.5)))
    return mask, "" if bool(mask.any()) else "nothing has the hand's colours"


@on_host
def other_pieces(
    image: UInt8[Tensor, "height width 3"],
    mask: Bool[Tensor, "height width"],
    appearance: Appearance | None,
    silhouette: SilhouetteSettings | None = None,
) -> list[Bool[Tensor, "height width"]]:
    """Pieces of a picture that may be the hand where `segment_hand` took another one for it, `mask`.

    The largest other pieces of its colours, by learned ones or those of the likeliest piece, and without learned ones
    what may be skin otherwise (`skin_candidates`, rough outlines). None by a plate or a screen.
    """
    if appearance is not None:
        return _apart(appearance.probability(image) > 0.5, mask)
    if silhouette is not None and silhouette.method != "skin":
        return []
    skin = bootstrap_skin(image)
    found = _apart(skin_probability(image, skin.model) > 0.5, mask) if skin.has_skin else []
    for piece in skin_candidates(image):
        whole = enlarged_mask(piece, *mask.shape)
        if all(float(intersection_over_union(whole, one, empty=0.0)) < _SAME_PIECE for one in (mask, *found)):
            found.append(whole)
    return found


def _apart(alike: Tensor, mask: Tensor) -> list[Tensor]:
    """The largest pieces of what has some colours, beside one of them, `mask`."""
    found, least = label_pieces(clean(alike) & ~mask), _MIN_AREA_FRACTION * mask.numel()
    largest = found.areas.argsort(descending=True, stable=True)[:_MOST_OTHERS].tolist()
    return [fill_holes(found.labels == number + 1) for number in largest if int(found.areas[number]) >= least]


@on_host
def find_hand(
    image: UInt8[Tensor, "height width 3"],
    posture: Float[Tensor, "36"],
    fitter: ContourFitter,
    *,
    appearance: Appearance | None = None,
    min_overlap: float = 0.75,
    silhouette: SilhouetteSettings | None = None,
    plate: BackgroundPlate | None = None,
    looks_elsewhere: bool = True,
) -> Start | NoStart:
    """Segments the picture, lays the posture over the silhouette, fits pose and shape, and judges the result.

    The likeliest piece of the picture is looked at first (`segment_hand`). looks_elsewhere: whether, where that shows
    no hand, the one of the others is looked at on which the posture lies best (`other_pieces`): a face is often the
    larger one.
    """
    mask, reason = segment_hand(image, appearance, silhouette, plate)
    first = _Piece.of(image, mask, ~mask, posture, fitter)
    best = _start_in(first, fitter, appearance)
    if _is_found(best, min_overlap):
        return best
    if looks_elsewhere:
        pieces = other_pieces(image, mask, appearance, silhouette)
        rest = ~torch.stack((mask, *pieces)).any(0)
        others = [_Piece.of(image, piece, rest, posture, fitter) for piece in pieces]
        likeliest = min(others, key=lambda one: one.cost, default=first)
        other = None
        if likeliest.cost < min(first.cost, _WORST_OTHER):
            other = _start_in(likeliest, fitter, appearance)
        other = None if other is None else _sharpened(image, other, fitter)
        least = max(min_overlap, _GOOD_OTHER)
        if _is_found(other, least, _GOOD_OTHER) and _has_tips_apart(other.fit, posture, fitter):
            return other
    if float(mask.float().mean()) < _MIN_AREA_FRACTION:
        return NoStart(reason=reason or "too little of the picture has the hand's colours", has_foreground=False)
    got = f"best overlap {best.overlap:.2f}, edges on {best.fit.found_fraction:.0%}" if best else "no placement fits"
    return NoStart(reason=f"no hand in the posture of the start ({got})", has_foreground=True)


@on_host
def start_at_points(
    image: UInt8[Tensor, "height width 3"], points: StartPoints, posture: Float[Tensor, "36"], fitter: ContourFitter
) -> Start | NoStart:
    """Starts from the wrist and the middle fingertip that the user gives, as Stenger et al. (2001) start by hand.

    The colours of the palm so placed, against those around the hand, give a silhouette to fit; then those of the fitted
    hand give a better one. The better of palm and back is taken. The user is believed: there is no start only where no
    colours can be learned, and a small overlap is the caller's to judge.
    """
    best: Start | None = None
    where = (fitter.camera, fitter.kinematics, fitter.shape)
    for alignment in align_points(points[:2], points[2:], *where, posture):
        start = start_at_pose(image, HandPose.of(alignment.pose, alignment.root_reference), fitter)
        if isinstance(start, Start) and (best is None or start.overlap > best.overlap):
            best = start
    return best or NoStart(reason="the hand placed at the start points lies outside the picture", has_foreground=False)


@on_host
def start_at_pose(image: UInt8[Tensor, "height width 3"], pose: HandPose, fitter: ContourFitter) -> Start | NoStart:
    """Starts from a hand that is placed already, in the camera's frame.

    The colours of the palm so placed, against those around the hand, give a silhouette to fit; then those of the fitted
    hand give a better one. A small overlap is the caller's to judge.
    """
    at = pose.normalized()
    placed = Fit.of_start(at.dofs, at.reference, fitter.shape)
    start: Start | None = None
    for is_first in (True, False, False):
        appearance = _appearance_of(image, fitter, placed, palm_only=is_first)
        if appearance is None:
            break
        mask = fill_holes(clean(appearance.probability(image) > 0.5))
        placed = fitter.fitted(mask, placed)
        start = Start(fit=placed, appearance=appearance, overlap=fitter.overlap(mask, placed))
    return start or NoStart(reason="the placed hand lies outside the picture", has_foreground=False)


@on_host
def start_at_cut(mask: Bool[Tensor, "height width"], pose: HandPose, fitter: ContourFitter) -> Start:
    """Starts from a hand that is placed already, in the camera's frame, where a detector's keypoints are.

    mask: what is cut out about these (`cut_at_keypoints`), whatever its colours are. A small overlap is the caller's to
    judge.
    """
    at = pose.normalized()
    placed = fitter.fitted(mask, Fit.of_start(at.dofs, at.reference, fitter.shape))
    return Start(fit=placed, appearance=CutAtKeypoints(), overlap=fitter.overlap(mask, placed))


def coloured_at(
    image: UInt8[Tensor, "height width 3"], appearance: Appearance, model: Bool[Tensor, "height width"]
) -> Bool[Tensor, "height width"]:
    """What has the colours of a hand and touches the silhouette of a model of it, without small pieces and holes."""
    return touching(fill_holes(clean(appearance.probability(image) > 0.5)), model)


def _start_in(piece: _Piece, fitter: ContourFitter, appearance: Appearance | None) -> Start | None:
    """The best hand in one piece."""
    best, facing = _best_start(piece, piece.alignments, fitter, appearance, None)
    if best is not None and best.overlap >= _NEAR:
        near = [one for one in piece.alignments if one.facing == facing]
        others = [_spread(one, factor) for factor in _SPREADS for one in near]
        best, _ = _best_start(piece, others, fitter, appearance, best)
    return best


def _is_found(start: Start | None, min_overlap: float, min_found: float = _MIN_FOUND) -> TypeGuard[Start]:
    return start is not None and start.overlap >= min_overlap and start.fit.found_fraction >= min_found


def _sharpened(image: Tensor, start: Start, fitter: ContourFitter) -> Start:
    """A hand that was fitted to a rough outline, fitted to that by its colours."""
    assert isinstance(start.appearance, Appearance)
    projector = HandProjector(fitter.kinematics, fitter.camera, start.fit.shape)
    model = projector.silhouette(start.fit.pose, start.fit.root_reference)
    mask = coloured_at(image, start.appearance, model)
    fit = fitter.fitted(mask, start.fit)
    return replace(start, fit=fit, overlap=fitter.overlap(mask, fit))


def _has_tips_apart(fit: Fit, posture: Tensor, fitter: ContourFitter) -> bool:
    """Whether the fingertips lie at least half as far apart in the picture as a posture has them in space: two fingers
    that stretch look like an open hand on whose fingers others lie."""
    wanted, found = (
        fitter.kinematics(pose, fit.shape, root_reference=reference).keypoints[list(TIPS)]
        for pose, reference in ((posture.to(fit.shape), None), (fit.pose, fit.root_reference))
    )
    length = fitter.kinematics.shape_space.metric(fit.shape)["hand_length"] / fitter.length_px(fit)
    apart = length * torch.pdist(fitter.camera.project(found))
    return bool((apart > _APART * torch.pdist(wanted)).all())


def _spread(alignment: Alignment, factor: float) -> Alignment:
    """The alignment with its abductions wider or narrower: a finger that slid onto its neighbour tries again."""
    is_spread = torch.tensor([name.endswith("_aa") for name in DOFS])
    return replace(alignment, pose=torch.where(is_spread, factor * alignment.pose, alignment.pose))


def _best_start(
    piece: _Piece,
    alignments: Sequence[Alignment],
    fitter: ContourFitter,
    appearance: Appearance | None,
    best: Start | None,
) -> tuple[Start | None, str]:
    """The best hand of those fitted from some alignments and of `best`, as soon as one is good; and which side of it
    faces the camera, where it is one of the former."""
    facing, fits = "", fitter.fitted_each(piece.mask, alignments)
    for alignment in alignments:
        if best is not None and best.overlap > _GOOD:
            break
        start = _started(piece, next(fits), fitter, appearance)
        if start is not None and (best is None or start.quality > best.quality):
            best, facing = start, alignment.facing
    return best, facing


def _started(piece: _Piece, fit: Fit, fitter: ContourFitter, appearance: Appearance | None) -> Start | None:
    """A fitted hand as a start; None where much of it lies outside the picture, or teaches no colours."""
    camera = fitter.camera
    frames = fitter.kinematics(fit.pose, fit.shape, root_reference=fit.root_reference)
    if float(is_in_picture(camera.project(frames.keypoints), camera).double().mean()) < _MIN_INSIDE:
        return None
    quality = fitter.overlap(piece.mask, fit)
    if appearance is None:
        margin = max(1, round(0.01 * fitter.length_px(fit)))
        appearance = learn_appearance(piece.image, piece.mask, piece.rest, margin)
    return None if appearance is None else Start(fit=fit, appearance=appearance, overlap=quality)


def fit_overlap(mask: Tensor, kinematics: HandKinematics, camera: Camera, fit: Fit) -> float:
    """Overlap of a fitted hand's silhouette with a mask, forearm cut off."""
    projector = HandProjector(kinematics, camera, fit.shape)
    keypoints = camera.project(projector.frames(fit.pose, fit.root_reference).keypoints)
    reach = 1.35 * hand_length_px(camera, kinematics, fit.pose, fit.shape)
    region = hand_region((camera.height, camera.width), keypoints[0], keypoints[9], reach)
    model = projector.silhouette(fit.pose, fit.root_reference)
    return float(intersection_over_union(model, mask, region, empty=0.0))


def _appearance_of(image: Tensor, fitter: ContourFitter, fit: Fit, *, palm_only: bool) -> Appearance | None:
    """Colours of a placed hand, or of its palm alone, against its surroundings.

    The side where a forearm may be counts for neither, nor does what lies near the outline of a hand that is placed
    roughly.
    """
    camera, projector = fitter.camera, HandProjector(fitter.kinematics, fitter.camera, fit.shape)
    silhouette = projector.silhouette(fit.pose, fit.root_reference)
    keypoints = camera.project(projector.frames(fit.pose, fit.root_reference).keypoints)
    length_px = fitter.length_px(fit)
    size = (camera.height, camera.width)
    around = hand_region(size, keypoints[0], keypoints[9], 1.6 * length_px)
    inside, margin = silhouette, round(0.015 * length_px)
    if palm_only:
        middle = 0.45 * keypoints[0] + 0.55 * keypoints[9]
        inside = silhouette & disc(size, middle, 0.2 * length_px)
        margin = round(0.03 * length_px)
    return learn_appearance(image, inside, around & ~silhouette, max(1, margin))
