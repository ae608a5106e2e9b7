"""What a detector contradicts, finger by finger, and what is left of the network's view then."""

import torch
from torch import Tensor

from torchhand.fit.keypoints import PostureKeypoints
from torchhand.hand import DOFS, FINGERS, JOINT_DOFS, HandPose
from torchhand.propose import LearnedPosture
from torchhand.track.scene import SceneKeypoints, learned_observations

INDEX = FINGERS.index("index")
OF_INDEX = torch.tensor([name.startswith("index") for name in JOINT_DOFS])
OPEN = HandPose.of(torch.zeros(len(DOFS), dtype=torch.float64)).normalized()


def _posture(joints: Tensor, precision: Tensor) -> PostureKeypoints:
    dofs = torch.cat((OPEN.dofs[: -len(JOINT_DOFS)], joints))
    return PostureKeypoints(pose=HandPose(dofs=dofs[None], reference=OPEN.reference[None]), precision=precision[None])


def test_a_view_that_knows_nothing_of_a_finger_does_not_bear_it_out() -> None:
    """Two views: one sees the index bent by 70°, the other does not see it."""
    known = torch.full((len(JOINT_DOFS),), 1 / 0.1**2, dtype=torch.float64)
    straight = torch.zeros_like(known)
    bent = _posture(straight.masked_fill(OF_INDEX, 1.2), known)
    blind = _posture(straight, known.masked_fill(OF_INDEX, 0.0))
    shape = torch.zeros(1, dtype=torch.float64)  # postures do not ask for it
    only_index = [False] + [row == INDEX for row in range(len(FINGERS))]
    assert SceneKeypoints(pictures=(), postures=(bent, blind)).contradicted(OPEN, shape).tolist() == only_index
    # A view that sees the finger as it is bears it out, and one alone that knows nothing contradicts nothing.
    both = SceneKeypoints(pictures=(), postures=(bent, _posture(straight, known)))
    assert not bool(both.contradicted(OPEN, shape).any())
    assert not bool(SceneKeypoints(pictures=(), postures=(blind,)).contradicted(OPEN, shape).any())


def test_fingers_that_are_not_believed_tell_nothing_and_the_others_what_they_did() -> None:
    count = len(JOINT_DOFS)
    seen = LearnedPosture(
        joints=torch.linspace(-0.2, 1.0, count, dtype=torch.float64),
        variance=torch.linspace(0.01, 0.04, count, dtype=torch.float64),
        rotation=torch.eye(3, dtype=torch.float64)[None],
        weight=torch.ones(1, dtype=torch.float64),
        spread=torch.tensor(0.1, dtype=torch.float64),
    )
    without = torch.tensor([row == INDEX for row in range(len(FINGERS))])
    whole, direction = learned_observations(seen, OPEN)
    part, same = learned_observations(seen, OPEN, without=without)
    assert bool((part.precision[0, OF_INDEX] == 0).all())
    assert torch.equal(part.precision[0, ~OF_INDEX], whole.precision[0, ~OF_INDEX])
    assert type(same) is type(direction)
