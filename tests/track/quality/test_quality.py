"""What is known of a finger tells whether it is right."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.fit import learn_appearance
from torchhand.geometry import assumed_camera, rotation_from_vector
from torchhand.hand import DOFS, FINGERS, HandPose, posture
from torchhand.image import dilate, disc_kernel
from torchhand.simulate import Motion, SceneSettings, facing, render_sequence
from torchhand.track import TrackerSettings
from torchhand.track.quality import EVIDENCE, FingerEvidence, LogisticModel, Told, hand_evidence, qualities
from torchhand.track.scene import (
    Agreement,
    HandKeypoints,
    PlacedHand,
    Scene,
    SilhouetteComparison,
    View,
    scene_keypoints,
)

KINEMATICS = load_hand_model().kinematics("right", dtype=torch.float64)
CAMERA = replace(assumed_camera(320, 240, horizontal_fov_deg=50.0), is_assumed=False).to(dtype=torch.float64)
INDEX = FINGERS.index("index")


def _pose(name: str) -> HandPose:
    dofs = posture(name, dtype=torch.float64)
    dofs[:3] = torch.tensor((0.0, 0.09, 0.45))
    return HandPose.of(dofs, facing("back"))


def _scene(pose: HandPose, keypoints: HandKeypoints | None = None) -> Scene:
    """A picture of a hand, and its silhouette by its colours."""
    motion = Motion(name="still", poses=pose.dofs[None], root_reference=pose.reference, fps=30.0)
    look = SceneSettings(background="plain", supersampling=1, noise=1.0)
    [frame] = render_sequence(KINEMATICS, motion, CAMERA, look, torch.Generator().manual_seed(0))
    skin = learn_appearance(frame.image, frame.mask, ~dilate(frame.mask, disc_kernel(5)), 1)
    assert skin is not None
    return Scene(
        views=(View(image=frame.image, keypoints=keypoints),),
        masks=(None,),
        probabilities=(skin.probability(frame.image),),
        time_s=0.0,
    )


def _evidence(
    scene: Scene, pose: HandPose, std_m: float = 0.005, placed: PlacedHand | None = None
) -> dict[str, Tensor]:
    told = Told(
        pose=pose,
        placed=placed,
        shape=KINEMATICS.default_shape,
        tip_std=torch.full((5,), std_m, dtype=torch.float64),
        agreement=Agreement.of_overlaps(torch.tensor((0.95,), dtype=torch.float64)),
        keypoints=scene_keypoints(scene, (CAMERA,), KINEMATICS, TrackerSettings().keypoints),
    )
    found = FingerEvidence(KINEMATICS, (CAMERA,))(told, scene)
    assert found.shape == (5, len(EVIDENCE))
    return dict(zip(EVIDENCE, found.unbind(-1), strict=True))


def _bent(pose: HandPose, degrees: float) -> HandPose:
    """With another index finger."""
    dofs = pose.dofs.clone()
    for joint in ("mcp", "pip"):
        dofs[DOFS.index(f"index_{joint}_fe")] += torch.deg2rad(torch.tensor(degrees))
    return HandPose.of(dofs, pose.reference)


def test_a_hand_that_was_placed_in_reduced_pictures_tells_the_same() -> None:
    pose = _pose("point")
    scene = _scene(pose)
    placed = SilhouetteComparison(KINEMATICS, (CAMERA,), KINEMATICS.default_shape, side_px=160).placed(pose)
    expected = _evidence(scene, pose)
    for name, column in _evidence(scene, pose, placed=placed).items():
        torch.testing.assert_close(column, expected[name], rtol=0, atol=1e-9)


def test_a_finger_elsewhere_than_in_the_picture_has_no_edges_there() -> None:
    pose = _pose("open")
    scene = _scene(pose)
    right, wrong = _evidence(scene, pose), _evidence(scene, _bent(pose, 35.0))
    assert (right["outer_found"] > 0.6).all()
    assert (right["outer_missed"] < 0.1).all()
    assert wrong["outer_found"][INDEX] < 0.6 * right["outer_found"][INDEX]
    others = [i for i in range(5) if i != INDEX]
    assert torch.allclose(wrong["outer_found"][others], right["outer_found"][others], atol=0.12)


def test_a_hidden_finger_has_no_contour() -> None:
    """Fingers that are bent away behind the palm are not seen from the back."""
    fist = _evidence(_scene(_pose("fist")), _pose("fist"))
    seen = fist["outer_found"] + fist["outer_missed"] + fist["inner_found"] + fist["inner_missed"]
    open_hand = _evidence(_scene(_pose("open")), _pose("open"))
    assert (seen[1:] < 0.7).all()
    assert (open_hand["outer_found"][1:] > seen[1:]).all()


def test_how_a_finger_is_bent_and_the_hand_turned() -> None:
    pose = _pose("open")
    scene = _scene(pose)
    dofs = pose.dofs.clone()
    dofs[[DOFS.index(f"index_{joint}_fe") for joint in ("pip", "dip")]] = torch.pi / 4
    before, bent = _evidence(scene, pose), _evidence(scene, HandPose.of(dofs, pose.reference))
    assert bent["curl"][INDEX] == pytest.approx(0.5)
    assert bent["curl_squared"][INDEX] == pytest.approx(0.25)
    others = [i for i in range(5) if i != INDEX]
    torch.testing.assert_close(bent["curl"][others], before["curl"][others])
    edge_on = HandPose.of(
        pose.dofs, rotation_from_vector(torch.tensor((0.0, torch.pi / 2, 0.0), dtype=torch.float64)) @ facing("back")
    )
    away = HandPose.of(pose.dofs, facing("palm"))
    facings = [_evidence(scene, one)["facing"] for one in (pose, away, edge_on)]
    sight = pose.dofs[:3] / pose.dofs[:3].norm()
    assert torch.allclose(facings[0], sight[2].expand(5))
    assert torch.allclose(facings[1], facings[0])
    assert (facings[2] < 0.1).all()
    torch.testing.assert_close(before["facing_found"], before["facing"] * before["outer_found"])


def test_the_detector_and_the_belief_have_their_say() -> None:
    pose = _pose("open")
    frames = KINEMATICS(pose.dofs, KINEMATICS.default_shape, root_reference=pose.reference)
    scene = _scene(pose, HandKeypoints(points_px=CAMERA.project(frames.keypoints)))
    right, wrong = _evidence(scene, pose), _evidence(scene, _bent(pose, 60.0), std_m=0.02)
    assert (right["no_points"] == 0).all()
    assert wrong["points"][INDEX] > right["points"][INDEX] + 1.0
    assert torch.allclose(wrong["spread"] - right["spread"], torch.tensor(4.0, dtype=torch.float64).log())
    alone = _evidence(_scene(pose), pose)
    assert (alone["no_points"] == 1).all()
    assert (alone["points"] == 0).all()


@pytest.mark.parametrize("method", ["contour", "distance", "rig", "single"])
def test_the_models_of_the_package_prefer_what_is_right(method: str) -> None:
    """A finger with edges is better than one without, one that the detector sees elsewhere is worse."""
    pose = _pose("open")
    scene = _scene(pose)
    evidence = [torch.stack(tuple(_evidence(scene, one).values()), -1) for one in (pose, _bent(pose, 35.0))]
    (good, fingers), (bad, others) = (qualities(one, method) for one in evidence)  # type: ignore[arg-type]
    assert ((fingers > 0) & (fingers < 1)).all()
    assert fingers[INDEX] > others[INDEX]
    assert good > bad


def test_a_hand_is_as_good_as_its_worst_finger_and_all_of_them() -> None:
    evidence = torch.zeros(5, len(EVIDENCE), dtype=torch.float64)
    fingers = torch.tensor((0.9, 0.5, 1.0, 0.8, 0.7), dtype=torch.float64)
    whole = hand_evidence(evidence, fingers)
    assert whole[0].exp() == pytest.approx(0.9 * 0.5 * 0.8 * 0.7)
    assert whole[1].exp() == pytest.approx(0.5)


def test_models_of_other_evidence_are_refused() -> None:
    with pytest.raises(ValueError, match="expected weights of"):
        LogisticModel.of_json({"bias": 0.0, "weights": {"spread": 1.0}}, EVIDENCE)
