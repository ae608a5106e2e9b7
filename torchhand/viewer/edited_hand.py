"""A hand whose angles and proportions are changed one by one, and what is to be told of it."""

import json
import math
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from torchhand import __version__
from torchhand.geometry import rotation_from_vector, vector_from_rotation
from torchhand.hand import DOFS, JOINT_DOFS, KEYPOINTS, HandModel, HandState, Side, penetration, posture
from torchhand.hand.limits import TIES
from torchhand.signs import load_signs, standing_pose

_ROOT = len(DOFS) - len(JOINT_DOFS)
_TOLD_DEG = 1.0  # by which an angle that another leads is off
_ROUNDED_RAD = math.radians(1e-3)  # by which the file of signs may be beyond a limit
# Of the viewer before the palm: x right, y down, z forward, in the hand's frame (x out of the back, y to the fingers).
_STAGE_FROM_VIEWER = ((0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0))
POSE_FORMAT = "torchhand pose 1"


class EditedHand:
    """Pose and proportions of one hand, in float64; every change leaves a hand that can be computed."""

    def __init__(
        self,
        model: HandModel,
        *,
        side: Side = "right",
        shape: Float[Tensor, "shape"] | None = None,
        seed: int = 0,
    ) -> None:
        self.model = model
        self.side: Side = side
        self.shape: Float64[Tensor, "shape"] = (model.shape_space.default if shape is None else shape).double().clone()
        self.pose: Float64[Tensor, "36"] = posture("open", dtype=torch.float64)
        self.follows = False
        """Whether the angles that others lead follow them (`TIES`)."""
        self._hand = model.hand(self.shape, side=side, dtype=torch.float64)
        self._prior = model.prior(dtype=torch.float64)
        self._generator = torch.Generator().manual_seed(seed)

    def limits(self, dof: str) -> tuple[float, float]:
        """Of a joint angle, radians."""
        index, skeleton = JOINT_DOFS.index(dof), self.model.skeleton
        return float(skeleton.lower[index]), float(skeleton.upper[index])

    def set_dof(self, dof: str, value: float) -> None:
        """Change one degree of freedom, metres or radians; joint angles stop at their limits."""
        if dof in JOINT_DOFS:
            low, high = self.limits(dof)
            value = min(max(value, low), high)
        self.pose[DOFS.index(dof)] = value
        if self.follows:
            self._follow()

    def set_follows(self, follows: bool) -> None:
        """Whether the angles that others lead follow them from now on."""
        self.follows = follows
        if follows:
            self._follow()

    def set_parameter(self, name: str, value: float) -> None:
        """Change one proportion, in its own unit, within its bounds."""
        space = self.model.shape_space
        index = space.names.index(name)
        self.shape[index] = min(max(value, float(space.lower[index])), float(space.upper[index]))

    def reset_shape(self) -> None:
        """The default proportions."""
        self.shape = self.model.shape_space.default.double().clone()

    def take_posture(self, name: str) -> None:
        """A named posture; the hand stays where it is."""
        self._take_joints(posture(name, dtype=torch.float64))

    def take_sign(self, sign: str) -> None:
        """A sign of the manual alphabet, as a hand of the default proportions makes it, facing as it is to be read by
        who looks at the palm of a hand that is not turned, fingers up."""
        pose = standing_pose(sign, load_signs()[sign], self.model, side=self.side).double()
        allowed = self._prior.constraints.project(pose)
        if float((allowed - pose).abs().max()) <= _ROUNDED_RAD:
            pose = allowed
        stage_from_hand = pose.new_tensor(_STAGE_FROM_VIEWER) @ rotation_from_vector(pose[3:_ROOT])
        self.pose = torch.cat((self.pose[:3], vector_from_rotation(stage_from_hand), pose[_ROOT:]))

    def draw(self, *, with_shape: bool) -> None:
        """A posture drawn from the prior, and with it the proportions of somebody."""
        poses, shapes = self._prior.sample(1, self._generator)
        self._take_joints(poses[0])
        if with_shape:
            self.shape = shapes[0].clone()

    def make_feasible(self) -> None:
        """The nearest posture that limits and couplings allow."""
        self._take_joints(self._prior.constraints.project(self.pose))

    @torch.inference_mode()
    def state(self) -> HandState:
        """The hand in the world, metres."""
        return self._hand(self.pose, self.shape)

    @torch.inference_mode()
    def told(self) -> dict[str, str]:
        """What limits, couplings, parts and prior say of it, in words."""
        density = float(self._prior.log_prob(self.pose, self.shape))
        ties = self._prior.constraints.tie_residuals(self.pose).tolist()
        off = [(tie, math.degrees(amount)) for tie, amount in zip(TIES, ties, strict=True)]
        led = [f"{tie.name} ({amount:+.0f}°)" for tie, amount in off if abs(amount) >= _TOLD_DEG]
        return {
            "log-density": f"{density:.1f}" if math.isfinite(density) else "impossible",
            "couplings broken": self._prior.constraints.violation(self.pose).describe(),
            "proportions outside people's": self._prior.population.violation(self.shape).describe(),
            "parts overlap": penetration(self.state().primitives).describe(),
            "angles that do not follow": "; ".join(led) or "none",
        }

    def as_json(self) -> str:
        """The pose as text: every degree of freedom by name, with the keypoints."""
        values = dict(zip(DOFS, self.pose.tolist(), strict=True))
        keypoints = self.state().keypoints.tolist()
        content: dict[str, Any] = {
            "format": POSE_FORMAT,
            "torchhand": __version__,
            "side": self.side,
            "units": "metres, radians",
            "pose": values,
            "pose_deg": {name: math.degrees(values[name]) for name in DOFS[3:]},
            "shape": dict(zip(self.model.shape_space.names, self.shape.tolist(), strict=True)),
            "keypoints3d": dict(zip(KEYPOINTS, keypoints, strict=True)),
        }
        return json.dumps(content, indent=1, allow_nan=False) + "\n"

    def as_obj(self) -> str:
        """The skin as a Wavefront OBJ file, metres."""
        state = self.state()
        lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in np.asarray(state.vertices).tolist()]
        lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in state.faces.tolist()]
        return "\n".join(lines) + "\n"

    def _take_joints(self, pose: Tensor) -> None:
        self.pose = torch.cat((self.pose[:_ROOT], pose[_ROOT:].double()))
        if self.follows:
            self._follow()

    def _follow(self) -> None:
        joints = self.pose[_ROOT:].clone()
        for index, tie in enumerate(TIES):
            joints[tie.target] = self._prior.constraints.tied_angle(index, joints)
        self.pose[_ROOT:] = joints
