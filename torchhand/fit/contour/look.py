"""A look of registration at the posed models: what is visible, what belongs to what, what counts how much."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.fit import Beliefs, Expectation
from torchhand.fit.contour.cost import LookedAt, RegistrationCost
from torchhand.fit.contour.coverage import match_boundary
from torchhand.fit.contour.picture_contours import PictureContours
from torchhand.fit.contour.settings import RegistrationSettings
from torchhand.fit.contour.springs import PictureTerms
from torchhand.view import ContourLook, Contours

_STEEP = 0.15  # share of the hand's length: a palm seen shorter than this has no direction in the picture


@dataclass(frozen=True, kw_only=True)
class Looker:
    """What all looks of one registration have in common."""

    picture: PictureContours
    contours: Contours
    settings: RegistrationSettings
    beliefs: Beliefs
    length_px: float
    """Of the hand in the picture."""

    def robust_px(self, level: int) -> float:
        """Distance beyond which residuals of a level are gross."""
        return self.settings.levels[level].robust_share * self.length_px

    def __call__(
        self,
        pose: Float[Tensor, "k 36"],
        root_reference: Float[Tensor, "k 3 3"],
        level: int,
        expected: Expectation | None,
    ) -> RegistrationCost:
        """The cost of a level around the poses. expected: with the rotations about their references."""
        settings, picture, length_px, robust_px = self.settings, self.picture, self.length_px, self.robust_px(level)
        field, boundary = picture.fields[level], picture.boundary
        look = self.contours.look(pose, root_reference, beyond_px=1 + settings.beyond_share * length_px)
        match = match_boundary(
            boundary, look.points_px, look.normals, look.outer, turn_px=settings.turn_share * length_px
        )
        precision = max(settings.contour_std_px, settings.contour_std_share * robust_px) ** -2
        outer, inner = look.outer.to(pose), look.inner.to(pose)
        fingerwards = _fingerwards(look, boundary.points_px.to(pose), _STEEP * length_px).to(pose)
        each = settings.contour_weight * precision / outer.sum(-1, keepdim=True).clamp_min(1)
        of_each = settings.coverage_weight * precision / fingerwards.sum(-1, keepdim=True).clamp_min(1)
        if picture.valleys is not None:
            outer = torch.add(outer, inner, alpha=settings.valley_weight)
        terms = PictureTerms.of(
            look,
            field.channels,
            boundary,
            match,
            torch.cat((each * outer, of_each * fingerwards), 1),
            robust_px=robust_px,
            valley_robust_px=settings.valley_robust_share * length_px,
            unmatched_px=length_px,
        )
        held = LookedAt(
            root_reference=root_reference, look=look, terms=terms, beliefs=self.beliefs.held(pose, expected)
        )
        return RegistrationCost(
            contours=self.contours, beliefs=self.beliefs, held=held, field=field, valleys=picture.valleys
        )


def hand_length_px(contours: Contours, pose: Float[Tensor, "k 36"]) -> float:
    """Length in the picture of a hand held parallel to it at the hypotheses' median depth."""
    camera, kinematics = contours.camera, contours.kinematics
    length = float(contours.shape[kinematics.shape_space.names.index("hand_length")])
    focal = 0.5 * float(camera.intrinsics[0, 0] + camera.intrinsics[1, 1])
    if camera.kind == "orthographic":
        return focal * length
    depth = camera.cam_from_world(pose[:, :3])[:, 2]
    depth = depth[depth.isfinite() & (depth > 0)]
    return focal * length / float(depth.median()) if len(depth) else float(camera.height)


def _fingerwards(
    look: ContourLook, boundary_px: Float[Tensor, "boundary 2"], least_px: float
) -> Bool[Tensor, "hands boundary"]:
    """Which of the picture's points are on the fingers' side of the wrist: beyond it there may be a forearm."""
    length = look.fingerwards_px.norm(dim=-1)
    ahead = ((boundary_px - look.wrist_px[:, None]) * look.fingerwards_px[:, None]).sum(-1)
    return (ahead > 0) | ~(length > least_px)[:, None]
