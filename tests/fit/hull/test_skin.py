"""Points of the skin and how they move: equal to the posed hand and to its Jacobian, hand by hand."""

import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.fit.hull.skin import SkinPoints
from torchhand.geometry import rotation_from_vector
from torchhand.hand import HandModel, HandPose, PosedMesh, posed_mesh, skin_jacobian


@pytest.fixture(scope="module")
def model() -> HandModel:
    return load_hand_model()


def posed(model: HandModel, count: int, generator: torch.Generator) -> HandPose:
    """With rotation vectors that are not zero."""
    dofs, _ = model.prior(dtype=torch.float64).sample(count, generator)
    dofs = dofs.double()
    dofs[:, :6] = 0.3 * torch.randn(count, 6, generator=generator, dtype=torch.float64)
    spin = torch.randn(count, 3, generator=generator, dtype=torch.float64)
    return HandPose(dofs=dofs, reference=rotation_from_vector(spin))


@pytest.mark.parametrize("side", ["right", "left"])
def test_same_as_the_hand_and_its_jacobian(model: HandModel, side: str, generator: torch.Generator) -> None:
    hand = model.hand(dtype=torch.float64, side="left" if side == "left" else "right")
    shape = model.prior().population.sample(1, generator, dtype=torch.float64)[0]
    skin, pose = SkinPoints(hand, shape), posed(model, 3, generator)
    own, common = torch.randint(2010, (3, 60), generator=generator), torch.randint(2010, (60,), generator=generator)
    direction = torch.randn(3, 60, 3, generator=generator, dtype=torch.float64)
    for index in (own, common):
        motion = skin.motion(skin.posed(pose), skin.weighted(index))
        wide = index.expand(3, 60)[..., None]
        points, jacobian = skin_jacobian(hand, pose.dofs, wide, shape=shape, root_reference=pose.reference)
        assert torch.allclose(motion.points, points, atol=1e-14)
        exact = (direction[..., None, :] @ jacobian).squeeze(-2)
        assert torch.allclose(motion.along(direction), exact, atol=1e-13)


def test_whole_skin_normals_and_bones(model: HandModel, generator: torch.Generator) -> None:
    hand = model.hand(dtype=torch.float64)
    skin, pose = SkinPoints(hand), posed(model, 2, generator)
    state = hand(pose.dofs, root_reference=pose.reference)
    mesh: PosedMesh = posed_mesh(hand, state)
    bones = skin.posed(pose)
    vertices = skin.skin_on(bones)
    assert torch.allclose(vertices, state.vertices, atol=1e-14)
    assert torch.equal(skin.vertices(pose), vertices)
    assert torch.allclose(skin.normals(vertices), mesh.vertex_normals(), atol=1e-10)
    assert torch.allclose(bones.rotation, state.frames.rotation, atol=1e-14)
    assert torch.allclose(bones.position, state.frames.position, atol=1e-14)


def test_rows_of_hands_and_one_hand_alone(model: HandModel, generator: torch.Generator) -> None:
    skin, pose = SkinPoints(model.hand(dtype=torch.float64)), posed(model, 3, generator)
    vertices = skin.weighted(torch.randint(2010, (3, 30), generator=generator))
    rows = torch.tensor([2, 0])
    direction = torch.randn(3, 30, 3, generator=generator, dtype=torch.float64)
    whole = skin.motion(skin.posed(pose), vertices).along(direction)
    some = skin.motion(skin.posed(pose[rows]), vertices.rows(rows)).along(direction[rows])
    assert torch.allclose(whole[rows], some, atol=1e-15)


def test_a_hand_with_many_shapes_is_refused(model: HandModel) -> None:
    hand = model.hand(model.shape_space.default.expand(2, -1))
    with pytest.raises(ValueError, match=r"shape: expected that of one hand, got shape \(2, 52\)"):
        SkinPoints(hand)
